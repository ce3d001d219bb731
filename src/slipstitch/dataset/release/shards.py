"""Image shards of a release, one part of the splits per shard, and previews drawn from them."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from PIL import Image, ImageDraw, ImageFont

from slipstitch.base.errors import BadInput
from slipstitch.base.page.wording import evenly
from slipstitch.base.progress import progress
from slipstitch.base.provenance import read_parquet
from slipstitch.dataset.videos import DATASET_SCHEMA, decode

PREVIEWS = "previews"
NAMES = ("fabrics_by_friction", "viewpoints_by_texture", "through_time")
_LARGEST_TILES = 12  # in a row or a column
_SMALLEST_TILE_PX = 112
_GAP = 4
# Words stand to the left of the tiles and above them.
LEFT = 150
TOP = 22
_PAPER, _INK = "#ffffff", "#22262b"

Row = Mapping[str, Any]
Show = Callable[[Row, int], np.ndarray]


def reader(folder: Path) -> Show:
    """A function that gives one image of a video by its manifest row and its place in it."""
    kept: dict[str, Any] = {}

    def show(row: Row, position: int) -> np.ndarray:
        shard = row["shard"]
        if shard not in kept:
            kept.clear()
            kept[shard] = pq.read_table(folder / shard, columns=["image"])["image"]
        image = kept[shard][row["first_row"] + position]["bytes"].as_py()
        return decode(image, f"{row['video']} position {position}")

    return show


def sheet(
    tiles: Sequence[Sequence[np.ndarray | None]], rows: Sequence[str], columns
) -> Image.Image:
    """Tiles with words before the rows and above the columns; None leaves a gap."""
    side = next(tile for line in tiles for tile in line if tile is not None).shape[0]
    scale = max(1, -(-_SMALLEST_TILE_PX // side))
    step = side * scale + _GAP
    width, height = LEFT + step * len(columns), TOP + step * len(rows)
    picture = Image.new("RGB", (width, height), _PAPER)
    draw = ImageDraw.Draw(picture)
    font = ImageFont.load_default(12)
    for across, word in enumerate(columns):
        draw.text((LEFT + step * across, 4), str(word), fill=_INK, font=font)
    for down, (word, line) in enumerate(zip(rows, tiles, strict=True)):
        draw.text((4, TOP + step * down + 4), str(word), fill=_INK, font=font)
        for across, tile in enumerate(line):
            if tile is not None:
                image = Image.fromarray(tile).resize((side * scale,) * 2, Image.Resampling.NEAREST)
                picture.paste(image, (LEFT + step * across, TOP + step * down))
    return picture


def _table(
    rows: Sequence[Row], down: str, across: str, position: int, show: Show
) -> tuple[list, list, list]:
    """Tiles of a sheet: values of the column `down` by values of the column `across`."""
    first: dict[tuple, Row] = {}
    for row in rows:
        first.setdefault((row[down], row[across]), row)
    downs = evenly(list(dict.fromkeys(row[down] for row in rows)), _LARGEST_TILES)
    acrosses = evenly(list(dict.fromkeys(row[across] for row in rows)), _LARGEST_TILES)
    # In the order of the shards, so that each is read once.
    wanted = {key: first[key] for key in first if key[0] in downs and key[1] in acrosses}
    images = {
        key: show(row, position)
        for key, row in sorted(wanted.items(), key=lambda item: item[1]["shard"])
    }
    return [[images.get((d, a)) for a in acrosses] for d in downs], downs, acrosses


def write_previews(folder: Path, rows: Sequence[Row]) -> dict[str, str]:
    """Draw the previews of a release into it; path in the release -> what it shows."""
    (folder / PREVIEWS).mkdir()
    show = reader(folder)
    rows = sorted(rows, key=lambda row: row["video"])
    first = rows[0]
    middle = first["frames"] // 2
    alike = [row for row in rows if all(row[k] == first[k] for k in ("texture_id", "viewpoint_id"))]
    pictures: dict[str, str] = {}

    def draw(name: str, words: str, tiles, downs, acrosses) -> None:
        path = f"{PREVIEWS}/{name}.png"
        sheet(tiles, downs, acrosses).save(folder / path)
        pictures[path] = words

    tiles, downs, frictions = _table(alike, "material", "friction", middle, show)
    words = "Fabrics by friction coefficient, all at the same time (texture {texture}, viewpoint "
    words += "{viewpoint})"
    draw(NAMES[0], words.format(**first), tiles, downs, [f"friction {mu:g}" for mu in frictions])
    same = [row for row in rows if row["simulation"] == first["simulation"]]
    words = "One moment of one simulation ({material}, friction {friction:g}) from every viewpoint "
    words += "in every texture"
    draw(NAMES[1], words.format(**first), *_table(same, "viewpoint", "texture", middle, show))
    positions, chosen = evenly(range(first["frames"]), 8), evenly(alike, 6)
    tiles = [[show(row, position) for position in positions] for row in chosen]
    downs = [f"{row['material']}\nfriction {row['friction']:g}" for row in chosen]
    draw(NAMES[2], "Videos over time, one per row", tiles, downs, [f"image {k}" for k in positions])
    return pictures


FOLDER = "data"


class PartWriter:
    """Writes the shards of one part; a new one begins when `shard_bytes` are passed."""

    def __init__(self, folder: Path, part: str, shard_bytes: float):
        self.folder, self.part, self.shard_bytes = folder, part, shard_bytes
        self.rows: list[int] = []
        self._writer: pq.ParquetWriter | None = None
        self._bytes = 0

    def _path(self, number: int) -> Path:
        return self.folder / f"{self.part}-{number:05d}.parquet"

    def write(self, table: pa.Table) -> tuple[int, int]:
        """Append rows that must stay together; return (number of the shard, first row in it)."""
        if self._writer is None:
            # PNG does not compress any further, the labels do.
            labels = [name for name in DATASET_SCHEMA.names if name != "image"]
            self._writer = pq.ParquetWriter(
                self._path(len(self.rows)),
                DATASET_SCHEMA,
                compression={**dict.fromkeys(labels, "ZSTD"), "image": "NONE"},
                use_dictionary=labels,
            )
            self.rows.append(0)
            self._bytes = 0
        place = len(self.rows) - 1, self.rows[-1]
        self._writer.write_table(table)
        self.rows[-1] += table.num_rows
        self._bytes += table.nbytes
        if self._bytes >= self.shard_bytes:
            self.close()
        return place

    def close(self) -> None:
        """Finish the shard that is being written."""
        if self._writer is not None:
            self._writer.close()
            self._writer = None

    def finish(self) -> list[str]:
        """Name the shards ``<part>-00000-of-0000N.parquet``; return their paths in the release."""
        self.close()
        names = []
        for number in range(len(self.rows)):
            name = f"{self.part}-{number:05d}-of-{len(self.rows):05d}.parquet"
            self._path(number).rename(self.folder / name)
            names.append(f"{FOLDER}/{name}")
        return names


def write_shards(
    sample_dir: Path,
    rows: Sequence[Mapping[str, Any]],
    part_of: Mapping[str, str],
    out: Path,
    shard_mb: float,
) -> dict[str, dict[str, Any]]:
    """Write all images to ``data/`` in `out`; return by video ``shard`` and ``first_row`` in it.

    BadInput if a video is not where the manifest, whose `rows` these are, says.
    """
    folder = out / FOLDER
    folder.mkdir()
    files = list(dict.fromkeys(row["file"] for row in rows))
    writers = {
        part: PartWriter(folder, part, shard_mb * 1e6) for part in sorted(set(part_of.values()))
    }
    frames = {row["video"]: row["frames"] for row in rows}
    videos_of = {file: [row["video"] for row in rows if row["file"] == file] for file in files}
    places: dict[str, tuple[str, int, int]] = {}
    try:
        for file in progress(files, "release: ", unit="file"):
            table = read_parquet(sample_dir / file)
            if not table.schema.equals(DATASET_SCHEMA):
                raise BadInput(f"{sample_dir / file}: its columns are not those of the dataset")
            table = table.replace_schema_metadata(DATASET_SCHEMA.metadata)  # none of the run's
            starts = _starts(table, sample_dir / file)
            for part in sorted({part_of[video] for video in videos_of[file]}):
                videos = [video for video in videos_of[file] if part_of[video] == part]
                for video in videos:
                    if starts.get(video, (0, 0))[1] != frames[video]:
                        what = f"not the {frames[video]} rows of {video} that the manifest has"
                        raise BadInput(f"{sample_dir / file}: {what}")
                together = pa.concat_tables(table.slice(*starts[video]) for video in videos)
                number, first = writers[part].write(together.combine_chunks())
                for video in videos:
                    places[video] = (part, number, first)
                    first += frames[video]
    finally:
        for writer in writers.values():
            writer.close()
    names = {part: writer.finish() for part, writer in writers.items()}
    return {
        video: {"shard": names[part][number], "first_row": first}
        for video, (part, number, first) in places.items()
    }


def _starts(table: pa.Table, where: Path) -> dict[str, tuple[int, int]]:
    """Video -> (first row, rows); each video's rows follow each other."""
    runs = pc.run_end_encode(table["video"].combine_chunks())
    ends = runs.run_ends.to_pylist()
    found: dict[str, tuple[int, int]] = {}
    start = 0
    for video, end in zip(runs.values.to_pylist(), ends, strict=True):
        if video in found:
            raise BadInput(f"{where}: the rows of {video} are not consecutive")
        found[video] = (start, end - start)
        start = end
    return found
