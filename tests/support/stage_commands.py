"""The commands of the stages, in the folder of a finished smoke run.

`{out}` is a folder for what they write, `{shards}` all image shards of the grid, `{project}` the
folder of the workflow.
"""

from pathlib import Path

ONE = "m00_f0100_r00"
SWEEP = "results/calibrate/sweep/base.json"
TRAJECTORY = f"results/simulate/{ONE}.parquet"
PACKS = [f"results/render/shading/{ONE}_v00.parquet", f"results/render/shading/{ONE}_v01.parquet"]
SHARDS = [f"results/render/{ONE}_v00.parquet", f"results/render/{ONE}_v01.parquet"]
CONFIG = "--config results/config.json"
TRAINING = f"{CONFIG} --dataset results/sample --split by_simulation --seed 0"

COMMANDS = {
    "grid": f"grid {CONFIG} --out {{out}}/g.parquet",
    "sweep": f"calibrate {CONFIG} --sweep damping_s --out {{out}}/s.json",
    "calibrate": f"calibrate {CONFIG} --sweeps {SWEEP} --out {{out}}/c.json",
    "simulate": f"simulate {CONFIG} --calibration results/calibrate/calibration.json "
    f"--simulation {ONE} --out {{out}}/s.parquet",
    "simulate by hand": "simulate --material gray-interlock --friction 0.3 --set frames=20 "
    "--set vertices_per_side=21 --out {out}/s.parquet",
    "shade": f"render {CONFIG} --trajectory {TRAJECTORY} --viewpoint v00 "
    "--shading {out}/p.parquet",
    "compose": f"render {CONFIG} --trajectory {TRAJECTORY} --out-dir {{out}}/render "
    f"--from-shading {' '.join(PACKS)}",
    "preview": "render --preview --out-sheet {out}/x.png --out-video {out}/x.mp4 "
    f"{' '.join(SHARDS)}",
    "verify": f"render {CONFIG} --verify --trajectories results/simulate "
    f"--packs results/render/shading --out {{out}}/v.json {SHARDS[0]}",
    "sample": f"sample {CONFIG} --out-dir {{out}}/sample {{shards}}",
    "train": f"train {TRAINING} --network material_baseline --out-dir {{out}}/model",
    "instrument": f"instrument {TRAINING} --out-dir {{out}}/instrument",
    "evaluate": f"evaluate {CONFIG} --dataset results/sample --models results/train "
    "--out {out}/m.json --predictions {out}/p.parquet",
    "capture": f"capture surrogate {CONFIG} --bench {{out}}",
    "criticise": "criticise {project}/data/cases/surrogate_anisotropic --replicates 50 "
    "--out {out}/v.json --report {out}/v.html",
    "report": f"report {CONFIG} --results results --out {{out}}/i.html",
    "release": f"release {CONFIG} --results results --out-dir {{out}}/release",
}


def words_of(stage: str, run: Path, out: Path) -> list[str]:
    """The words after ``slipstitch`` for a stage of the run."""
    shards = sorted((run / "results/render").glob("m*_v*.parquet"))
    known = {"out": out, "project": run.parent / "project"}
    known["shards"] = " ".join(path.relative_to(run).as_posix() for path in shards)
    return COMMANDS[stage].format(**known).split()
