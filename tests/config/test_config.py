"""The typed configuration: what it accepts, how files merge, one clear line for what is wrong."""

import json
import re
from pathlib import Path

import pytest

from slipstitch.base.errors import BadInput
from slipstitch.config import Config, load_config, read_mapping, resolve_config, write_config
from slipstitch.config.model import schema_text
from slipstitch.config.render import AugmentationSettings
from slipstitch.design.stage_path import StagePath
from slipstitch.design.trainable import check_instrument_can_train, check_networks_can_train

ROOT = Path(__file__).parents[2]


SCALES = ["config.yaml", *sorted(f"config/{p.name}" for p in (ROOT / "config").glob("*.yaml"))]


def below(scale: str) -> list[Path]:
    """The files that a scale is merged over."""
    paper, instrument = "config/paper.yaml", "config/instrument.yaml"
    others = {
        instrument: [paper],
        "config/paper_reflective.yaml": [paper],
        "config/error_bars.yaml": [paper, instrument],
    }
    return [ROOT / name for name in ("config.yaml", *others.get(scale, ()))]


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("scale", SCALES[1:])
def test_scales_are_valid_and_hold_only_what_differs_from_the_default(scale):
    assert load_config(*below(scale), ROOT / scale).grid.materials
    default = load_config(*below(scale)).model_dump(mode="json")
    for section, values in read_mapping(ROOT / scale).items():
        assert values != default[section], f"{section} is the default's"
        for key, value in values.items() if isinstance(values, dict) else ():
            assert value != default[section][key], f"{section}.{key} is the default's"


def test_paper_scale_is_the_grid_of_the_paper_and_perturbs_nothing():
    """The same fabric hangs on the same bench at all coefficients, and at every seed."""
    config = load_config(ROOT / "config.yaml", ROOT / "config/paper.yaml")
    assert len(config.grid.materials) == 10
    assert config.grid.frictions == tuple(round(0.1 * step, 1) for step in range(16))
    render, simulation = config.render, config.simulation
    assert [len(one) for one in (render.textures, render.test_textures)] == [8, 1]
    assert [len(one) for one in (render.viewpoints, render.test_viewpoints)] == [3, 6]
    assert (simulation.frames, config.sample.frames, simulation.curl_side) == (300, 30, "same")
    assert simulation.yaw_sd_deg == simulation.height_sd_m == simulation.fabric_sd_rel == 0.0
    assert (render.augmentation, render.floors) == (AugmentationSettings(), ["matte"])


def test_later_files_override_earlier_ones_key_by_key_and_an_empty_one_is_the_default(tmp_path):
    first = write(tmp_path / "a.yaml", "grid: {replicates: 3, frictions: [0.1, 0.2]}\nseed: 4\n")
    second = write(tmp_path / "b.yaml", "grid: {frictions: [0.5]}\n")
    config = load_config(first, second)
    assert (config.seed, config.grid.replicates, config.grid.frictions) == (4, 3, (0.5,))
    assert load_config(write(tmp_path / "empty.yaml", "# nothing\n")) == Config()


def test_scientific_notation_is_a_number_and_words_are_only_where_asked_for(tmp_path):
    """YAML 1.1 reads 1e-2, without a point, as a string."""
    config = load_config(write(tmp_path / "c.yaml", "simulation: {time_step_s: 1e-2}\n"))
    assert config.simulation.time_step_s == 0.01
    words = {"grid": {"replicates": "3", "frictions": ["0.1", "2e-1"]}}
    config = resolve_config(words, words=True)
    assert (config.grid.replicates, config.grid.frictions) == (3, (0.1, 0.2))
    with pytest.raises(BadInput, match=r"grid\.replicates: must be a whole number"):
        resolve_config(words)


BAD = {
    "grid: {friction: [0.1]}": "grid.friction: unknown key; did you mean frictions?",
    "colour: red": "colour: unknown key; known: seed, grid, simulation",
    "grid: {frictions: [0.3, -0.1]}": "grid.frictions.1: must be at least 0, not -0.1",
    "grid: {frictions: [0.3, 0.3004]}": "grid.frictions: must be a multiple of 0.001",
    "grid: {frictions: []}": "grid.frictions: must have at least 1 item, not 0",
    "grid: {frictions: 0.3}": "grid.frictions: must be a list, not 0.3",
    "grid: {frictions: [0.3, 0.1]}": "grid.frictions: friction coefficients must increase",
    "grid: {frictions: [.nan]}": "grid.frictions.0: must be a finite number",
    "grid: {materials: [silk]}": "grid.materials: unknown material 'silk'; known: ivory-rib-knit",
    "grid: {materials: [gray-interlock, gray-interlock]}": "grid.materials: duplicate material",
    "grid: {replicates: 1.5}": "grid.replicates: must be a whole number, not 1.5",
    "grid: {replicates: '2'}": "grid.replicates: must be a whole number, not '2'",
    "grid: {replicates: true}": "grid.replicates: must be a whole number, not true",
    "grid: {replicates: }": "grid.replicates: must be a whole number, not nothing",
    "grid: [1, 2]": "grid: must be a mapping of keys, not a list",
    "simulation: {frames: 0}": "simulation.frames: must be at least 1, not 0",
    "simulation: {time_step_s: soon}": "simulation.time_step_s: must be a number, not 'soon'",
    "render: {textures: [plaid]}": "render.textures: unknown texture 'plaid'; known: stripes",
    "render: {viewpoints: [below]}": "render.viewpoints: unknown viewpoint 'below'; known:",
    "sample: {frames: 400}": "sample.frames: 400 frames cannot be sampled from 300",
    "evaluate: {friction_step: 0.2}": "evaluate.friction_step: no longer a key; it is always",
    "instrument: {coverage: 0.8}": "instrument.coverage: no longer a key; it is always 0.9, not",
}


@pytest.mark.parametrize("text", BAD)
def test_bad_value_is_one_line_naming_file_and_key(tmp_path, text):
    path = write(tmp_path / "bad.yaml", text)
    with pytest.raises(BadInput) as caught:
        load_config(path)
    message = str(caught.value)
    assert "\n" not in message and BAD[text] in message
    if "sample" not in text:  # that concerns two sections
        assert message.startswith(f"{path}: ")


def test_every_problem_is_blamed_on_the_file_that_holds_it_in_one_line(tmp_path):
    good = write(tmp_path / "good.yaml", "grid: {replicates: 2}\n")
    bad = write(tmp_path / "bad.yaml", "grid: {frictions: [-1]}\nsimulation: {frames: 0}\n")
    with pytest.raises(BadInput, match=r"bad\.yaml: grid\.frictions\.0.*bad\.yaml: simulation\.fr"):
        load_config(bad, good)


BENCHES = {"render": {"test_viewpoints": ["bench_1"]}, "train": {"splits": ["by_simulation"]}}
GRID = {"frictions": [0.1, 0.5, 1.0], "materials": ["gray-interlock", "royal-target"]}
#: Sections that do not go together -> what is said.
APART = [
    # Cameras that would tell a simulation need whole simulations held out.
    ({"render": {"viewpoints": ["calibrated", "bench_1"]}}, "train.splits: 'by_video' tests on"),
    (BENCHES, "render.test_viewpoints: 'bench_1' is another camera in every simulation"),
    *(
        ({"grid": GRID, "sample": {key: values}}, f"sample.{key}: {problem}")
        for key, values, problem in (
            ("validation_materials", GRID["materials"], "has all of grid.materials"),
            ("train_only_frictions", [0.7], "0.7 is not in grid.frictions"),
            ("train_only_frictions", GRID["frictions"], "has all of grid.frictions"),
        )
    ),
]


@pytest.mark.parametrize(("sections", "problem"), APART)
def test_sections_that_do_not_go_together_are_refused(sections, problem):
    with pytest.raises(BadInput, match=re.escape(problem)):
        resolve_config(sections)
    some = {"validation_materials": ["royal-target"], "train_only_frictions": [1.0]}
    resolve_config({"grid": GRID, "sample": some})


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "cannot be read: No such file"),
        ("- 1\n- 2\n", "contains a list; must be a mapping of keys"),
        ("grid: [unclosed\n", "not YAML"),
        (b"\xff\xfe\x00", "cannot be read: not a text file"),
    ],
)
def test_file_that_is_no_configuration_is_one_line(tmp_path, content, message):
    path = tmp_path / "c.yaml"
    if content is not None:
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(BadInput, match=message) as caught:
        load_config(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def test_written_configuration_reads_back_and_is_left_alone_when_unchanged(tmp_path):
    path = tmp_path / "results" / "config.json"
    config = resolve_config({"seed": 7, "grid": {"frictions": [0.25]}})
    assert write_config(config, path) and load_config(path) == config
    assert json.loads(path.read_text()) == config.model_dump(mode="json")  # every key
    before = path.stat().st_mtime_ns
    assert not write_config(config, path) and path.stat().st_mtime_ns == before
    assert write_config(resolve_config({"seed": 8}), path)


def test_schema_file_is_that_of_the_types_and_accepts_and_refuses_what_they_do():
    import jsonschema

    file = ROOT / "workflow/schemas/config.schema.json"
    again = f"regenerate it: slipstitch schema > {file.relative_to(ROOT)}"
    assert file.read_text(encoding="utf-8") == schema_text(), again
    validator = jsonschema.Draft202012Validator(json.loads(schema_text()))
    for scale in SCALES:
        validator.validate(read_mapping(ROOT / scale))
    for bad in ({"grid": {"friction": [0.1]}}, {"grid": {"frictions": [-0.1]}}, {"seed": "one"}):
        assert not validator.is_valid(bad)


def test_the_stage_moves_as_in_the_paper_unless_told_otherwise(tmp_path):
    assert StagePath(**dict(Config().simulation.stage)) == StagePath()
    faster = write(tmp_path / "faster.yaml", "simulation: {stage: {speed_m_s: 0.02}}\n")
    path = StagePath(**dict(load_config(faster).simulation.stage))
    assert path == StagePath(speed_m_s=0.02) and path.duration_s < StagePath().duration_s


STAGES = {
    "{drop_m: 0.21}": "stage: drop_m must be less",
    "{start_height_m: 0.15}": "stage.start_height_m: must be at least 0.2, not 0.15",
    "{drop_m: 0}": "stage: drop_m must be more than 0.01, not 0;",
    "{start_height_m: 0.25, drop_m: 0.03}": "stage: drop_m must be more than 0.05",
}


@pytest.mark.parametrize("stage", STAGES)
def test_a_cloth_hangs_free_at_the_start_and_is_lowered_to_the_floor(tmp_path, stage):
    path = write(tmp_path / "stage.yaml", f"simulation: {{stage: {stage}}}\n")
    with pytest.raises(BadInput, match=re.escape(f"{path}: simulation.{STAGES[stage]}")):
        load_config(path)


NETWORKS, INSTRUMENT = check_networks_can_train, check_instrument_can_train
#: Who is to train, a key and its value -> what is said.
UNTRAINABLE = [
    (NETWORKS, "grid.materials", ["gray-interlock"], "has 1; the material network requires"),
    (NETWORKS, "grid.frictions", [0.3], "has 1; a friction network requires at least 2"),
    (NETWORKS, "sample.validation_materials", ["gray-interlock"], "keeps gray-interlock from it"),
    (INSTRUMENT, "grid.frictions", [0.3], "has 1; the instrument requires at least 2"),
    (INSTRUMENT, "instrument.viewpoints", ["calibrated", "side"], "'side' is not trained on"),
    (INSTRUMENT, "grid.frictions", [0.5, 2.0], "2 is above what the instrument can say, 1.5"),
    (INSTRUMENT, "grid.test_frictions", [1.6], "1.6 is above what the instrument can say, 1.5"),
]


@pytest.mark.parametrize(("check", "name", "value", "problem"), UNTRAINABLE)
def test_a_grid_that_cannot_train_is_refused_before_it_is_simulated(check, name, value, problem):
    section, key = name.split(".")
    check(Config())
    with pytest.raises(BadInput, match=re.escape(problem)) as caught:
        check(resolve_config({section: {key: value}}))
    assert key in str(caught.value) or section == "sample"


def test_an_instrument_needs_no_second_fabric_and_may_say_more_than_the_grid_has():
    grid = {"materials": ["gray-interlock"], "frictions": [0.5, 2.0]}
    check_instrument_can_train(resolve_config({"grid": grid, "instrument": {"friction_max": 2.0}}))
