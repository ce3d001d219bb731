"""A calibration that chooses other settings than configured: release and audit take its part."""

import json

import pytest
from support.workflow_copy import Workflow

from slipstitch.base.provenance import read_provenance

pytestmark = pytest.mark.slow

# No push of the strip is solved with the first, so that the calibration takes the second.
KEY = "newton_iterations_max"
CONFIGURED, CHOSEN = 2, 30
CLIP = "m05_f0600_r00_t00_v00"
SCALE = f"""
grid: {{materials: [gray-interlock], frictions: [0.1, 0.6], replicates: 2}}
simulation: {{{KEY}: {CONFIGURED}, frames: 24}}
calibrate:
  sweep_time_step_s: []
  sweep_vertices: []
  sweep_friction_tolerance: []
  sweep_{KEY}: [{CHOSEN}]
render: {{viewpoints: [calibrated], textures: [stripes], verified_images: 2}}
sample: {{frames: 4}}
"""


@pytest.fixture(scope="module")
def released(tmp_path_factory):
    workflow = Workflow(tmp_path_factory.mktemp("chosen"), scale="config/smoke.yaml")
    scale = workflow.project / "config/chosen.yaml"
    scale.write_text(SCALE)
    smoke = workflow.project / "config/smoke.yaml"
    answer = workflow.snakemake("audit", "--configfile", str(smoke), str(scale))
    assert answer.returncode == 0, answer.stderr[-5000:]
    return workflow


def test_the_simulations_were_told_other_settings_than_configured(released):
    results = released.folder / "results"
    config = json.loads((results / "config.json").read_text())
    assert config["simulation"][KEY] == CONFIGURED
    trajectories = list((results / "simulate").glob("*.parquet"))
    recorded = [read_provenance(path)["config"]["simulation"][KEY] for path in trajectories]
    assert recorded == [CHOSEN] * 4


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("--config results/config.json", "intact: every file"),
        (f"--explain {CLIP}", KEY),
        (f"--rebuild {CLIP}", "bit by bit"),
    ],
)
def test_the_release_is_intact_and_a_clip_explained_and_made_again(released, words, said):
    answer = released.run("slipstitch", "audit", "results/release", *words.split())
    assert answer.returncode == 0, answer.stdout + answer.stderr
    assert said in answer.stdout and "cannot be read" not in answer.stdout
