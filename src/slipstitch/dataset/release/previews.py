"""Preview pictures of a release, drawn from its own shards: appearance and variation."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from PIL import Image, ImageDraw, ImageFont

from slipstitch.base.page.wording import evenly
from slipstitch.dataset.shards import decode

FOLDER = "previews"
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
    (folder / FOLDER).mkdir()
    drawn = draw_previews(folder, rows)
    for path, (_, picture) in drawn.items():
        picture.save(folder / path)
    return {path: words for path, (words, _) in drawn.items()}


def draw_previews(folder: Path, rows: Sequence[Row]) -> dict[str, tuple[str, Image.Image]]:
    """Draw the previews of a release.

    Parameters
    ----------
    folder : path
        The release, shards in it.
    rows : sequence of mappings
        Its manifest.

    Returns
    -------
    dict
        Path in the release -> what it shows, and the picture.
    """
    show = reader(folder)
    rows = sorted(rows, key=lambda row: row["video"])
    first = rows[0]
    middle = first["frames"] // 2
    alike = [row for row in rows if all(row[k] == first[k] for k in ("texture_id", "viewpoint_id"))]
    pictures: dict[str, tuple[str, Image.Image]] = {}

    def draw(name: str, tiles, downs, acrosses, words: str) -> None:
        pictures[f"{FOLDER}/{name}.png"] = words, sheet(tiles, downs, acrosses)

    tiles, downs, acrosses = _table(alike, "material", "friction", middle, show)
    draw(
        NAMES[0], tiles, downs, [f"friction {mu:g}" for mu in acrosses],
        f"Fabrics by friction coefficient, all at the same time (texture {first['texture']}, "
        f"viewpoint {first['viewpoint']})",
    )  # fmt: skip
    same = [row for row in rows if row["simulation"] == first["simulation"]]
    tiles, downs, acrosses = _table(same, "viewpoint", "texture", middle, show)
    draw(
        NAMES[1], tiles, downs, acrosses,
        f"One moment of one simulation ({first['material']}, friction {first['friction']:g}) from "
        "every viewpoint in every texture",
    )  # fmt: skip
    positions = evenly(range(first["frames"]), 8)
    chosen = evenly(alike, 6)
    draw(
        NAMES[2],
        [[show(row, position) for position in positions] for row in chosen],
        [f"{row['material']}\nfriction {row['friction']:g}" for row in chosen],
        [f"image {position}" for position in positions],
        "Videos over time, one per row",
    )
    return pictures
