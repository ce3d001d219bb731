"""Comparison of a random sample of images with direct renders of the textured cloth in Blender."""

import base64
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import numpy as np

from slipstitch.base import provenance
from slipstitch.base.errors import BadInput, SlipstitchError
from slipstitch.config import Config
from slipstitch.design.grid import texture_ids
from slipstitch.images.composition import compose_light, join
from slipstitch.images.encoding import decode_image, encode_png, encode_srgb
from slipstitch.images.image_shards import SCHEMA
from slipstitch.images.packing import read_pack
from slipstitch.images.surroundings import generator
from slipstitch.images.textures import texture
from slipstitch.images.view import View

#: Paths per pixel of direct renders, for matte and reflective floors: on rough metal two renders
#: of 256 paths agree to an SSIM of 0.96 only, less than required of a composed image.
SAMPLES = {False: 256, True: 1024}
#: Requirements on a composed image, for matte and reflective floors.
LEAST_PSNR_DB = {False: 38.0, True: 36.0}
LEAST_SSIM = 0.97
#: What a verification does not depend on.
VIEWS = {"viewpoints", "test_viewpoints", "test_viewpoint_videos", "reflective_floors"}


@dataclass(frozen=True)
class Comparison:
    """One image of the dataset against a direct render."""

    video: str
    frame: int
    floor: str
    psnr_db: float
    ssim: float
    least_psnr_db: float
    as_stored: bool
    #: PNG files, base64: whoever has them can compare again.
    composed_png: str
    direct_png: str

    @property
    def passed(self) -> bool:
        """Whether the image is the one in the dataset, and near enough to the direct one."""
        return self.as_stored and self.psnr_db >= self.least_psnr_db and self.ssim >= LEAST_SSIM


def psnr_db(image: np.ndarray, reference: np.ndarray) -> float:
    """Peak signal-to-noise ratio (dB) of two 8-bit images."""
    error = np.mean((image.astype(np.float64) - reference) ** 2)
    return float(10 * np.log10(255**2 / max(error, 1e-12)))


def ssim(image: np.ndarray, reference: np.ndarray) -> float:
    """Structural similarity of two 8-bit RGB images' luma (Wang, Bovik, Sheikh & Simoncelli 2004).

    Gaussian windows of 11 pixels, standard deviation 1.5; windows inside the image only.
    """

    def mean(values: np.ndarray) -> np.ndarray:
        return cv2.GaussianBlur(values, (11, 11), 1.5)[5:-5, 5:-5]

    one, other = (cv2.cvtColor(x, cv2.COLOR_RGB2GRAY).astype(float) for x in (image, reference))
    m1, m2 = mean(one), mean(other)
    v1, v2 = mean(one**2) - m1**2, mean(other**2) - m2**2
    both = mean(one * other) - m1 * m2
    c1, c2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2
    similar = (2 * m1 * m2 + c1) * (2 * both + c2) / ((m1**2 + m2**2 + c1) * (v1 + v2 + c2))
    return float(similar.mean())


def compare(
    config: Config,
    shard: str | os.PathLike,
    row: int,
    trajectory_path: str | os.PathLike,
    pack_path: str | os.PathLike,
) -> Comparison:
    """Compare one row of a shard with a direct render, from the files that it was composed from."""
    from slipstitch.images.blender import ClothScene

    stored = provenance.read_parquet(shard).slice(row, 1).to_pylist()[0]
    seen_from = provenance.read_metadata(shard)["viewpoint"]
    view = View.identified(config, trajectory_path, seen_from["id"], seen_from["name"])
    name = texture_ids(config.render)[stored["texture"]]
    trajectory = view.trajectory()
    pack = read_pack(pack_path, view, trajectory)
    shot, shading, sight = next(pack.frames(trajectory, stored["frame"]))
    effects = view.camera_effects()[stored["texture"]]
    (light,) = compose_light(join(shading, sight), [view.worn(name)])
    rectified = view.rectifier(trajectory).at(shot.camera, shot.time_s)
    again = rectified(effects.photograph(light, view.noise(name, shot.frame)))
    scene = ClothScene(trajectory.faces, trajectory.uv, pack.surroundings)
    scene.wear(texture(view.worn(name)))
    # Another seed than the shading render's: the two share no noise.
    positions, seed = trajectory.positions_m[shot.row], 2**20 + shot.frame
    samples = SAMPLES[pack.surroundings.reflects]
    direct = scene.render(positions, shot.camera, samples=samples, seed=seed).radiance.sum(axis=0)
    composed, reference = (encode_srgb(effects.light(image)) for image in (light, direct))
    video = f"{view.simulation}_{stored['texture']}_{view.viewpoint_id}"
    image = decode_image(stored["image"]["bytes"], f"{shard}: {video} frame {shot.frame}")
    return Comparison(
        video,
        shot.frame,
        pack.surroundings.floor,
        psnr_db(composed, reference),
        ssim(composed, reference),
        LEAST_PSNR_DB[pack.surroundings.reflects],
        bool((image[..., ::-1] == again).all()),
        *(base64.b64encode(encode_png(one)).decode() for one in (composed, reference)),
    )


def drawn_rows(seed: int, wanted: int, rows: int) -> list[int]:
    """Which of the rows of all shards, in the order of their names, are compared."""
    chosen = generator(seed, "verification").choice(rows, min(wanted, rows), replace=False)
    return sorted(map(int, chosen))


def verify(
    config: Config,
    shards: Sequence[str | os.PathLike],
    trajectories: str | os.PathLike,
    packs: str | os.PathLike,
    out: str | os.PathLike,
    progress=iter,
) -> list[Comparison]:
    """Render a random sample of the shards' images directly, compare, write that as JSON.

    `trajectories` and `packs` are folders. BadInput if a file is missing or damaged;
    SlipstitchError if an image is not the dataset's, or too unlike the direct one.
    """
    started = provenance.start_clock()
    rows = []
    for path in sorted(map(str, shards)):
        with provenance.open_parquet(path) as file:
            if file.schema_arrow.names != SCHEMA.names:
                raise BadInput(f"{path}: not an image shard")
            rows += [(path, row) for row in range(file.metadata.num_rows)]
    drawn = drawn_rows(config.seed, config.render.verified_images, len(rows))
    chosen = [rows[k] for k in drawn]
    comparisons, inputs = [], set()
    for path, row in progress(chosen):
        simulation = Path(path).stem.rsplit("_", 1)[0]
        files = (Path(trajectories) / f"{simulation}.parquet", Path(packs) / Path(path).name)
        comparisons.append(compare(config, path, row, *files))
        inputs.update([path, *map(os.fspath, files)])
    worst = {
        "images": len(comparisons),
        "lowest_psnr_db": min((one.psnr_db for one in comparisons), default=None),
        "lowest_ssim": min((one.ssim for one in comparisons), default=None),
        "comparisons": [{**asdict(one), "passed": one.passed} for one in comparisons],
    }
    if failed := [one for one in comparisons if not one.passed]:
        raise SlipstitchError("; ".join(map(_complaint, failed)))
    record = provenance.provenance_record(
        "render",
        inputs=sorted(inputs),
        # Another viewpoint makes another dataset, but no comparison untrue.
        config={"render": config.render.model_dump(mode="json", exclude=VIEWS)},
        seed=config.seed,
        started=started,
    )
    provenance.write_json(out, worst, record, allow_nan=True)
    return comparisons


def _complaint(shown: Comparison) -> str:
    where = f"{shown.video} frame {shown.frame}"
    if not shown.as_stored:
        return f"{where}: the stored image differs from the one composed from its shading pack"
    return (
        f"{where} (floor {shown.floor}): {shown.psnr_db:.1f} dB and SSIM {shown.ssim:.3f} "
        f"against the direct render; at least {shown.least_psnr_db:g} dB and {LEAST_SSIM:g} are "
        "required"
    )
