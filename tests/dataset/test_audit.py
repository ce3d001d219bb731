"""An audit finds every planted alteration, says where, and raises no false alarm."""

import contextlib
import functools
import json
import random
import re
import shutil
import tempfile
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from support import synthetic_chain
from support.refusal import refused, run

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import attach_metadata, file_digest, write_parquet
from slipstitch.config import load_config, write_config
from slipstitch.config.catalogue import fabric_names
from slipstitch.dataset.audit import auditing, lineage_check
from slipstitch.dataset.audit.auditing import audit_release
from slipstitch.dataset.audit.contents import read_contents
from slipstitch.dataset.audit.findings import Kind
from slipstitch.dataset.manifest import dataset_digest, manifest_sides
from slipstitch.dataset.release import currency
from slipstitch.dataset.release.assembly import write_release
from slipstitch.dataset.release.checksums import read_sums
from slipstitch.dataset.release.manifest import sampled_rows
from slipstitch.dataset.release.records import SIMULATIONS, Artefact
from slipstitch.design import interpolation
from slipstitch.design.grid import simulations
from slipstitch.design.interpolation import interpolations
from slipstitch.images import view
from slipstitch.images.surroundings import FLOORS
from slipstitch.physics.fabric import load_fabric
from slipstitch.physics.simulation import simulation_files
from slipstitch.physics.simulation.convergence import MEASURED

ROOT = Path(__file__).parents[2]
CONFIG = synthetic_chain.config()
CLIP = "m05_f0300_r00_t00_v00"
CLIPS = list(manifest_sides(CONFIG))


@pytest.fixture
def release(forger):
    """A copy that a test may damage."""
    return forger.release


def found(release: Path, kind: Kind, **options) -> dict[str, set[str]]:
    """Place -> clips, of the findings of one kind."""
    places: dict[str, set[str]] = {}
    for finding in audit_release(release, **options).of_kind(kind):
        places.setdefault(finding.where, set()).update(finding.clips)
    return places


def row_of(release: Path, clip: str) -> dict:
    rows = pq.read_table(release / "manifest.parquet").to_pylist()
    return next(row for row in rows if row["video"] == clip)


def test_untouched_release_is_intact(original):
    audit = audit_release(original, CONFIG)
    assert (audit.findings, audit.verdict, audit.numbers["images"]) == ([], "intact", 720)
    assert sorted(audit.clips) == sorted(CLIPS) and len(CLIPS) == 144
    assert not any(audit.clip_kinds().values())


def test_a_release_carries_its_simulations_and_those_of_before_need_not(forger, release):
    assert SIMULATIONS == simulation_files.SIMULATIONS
    assert len(list((release / SIMULATIONS).glob("*.parquet"))) == len(simulations(CONFIG))
    (release / ".snakemake_timestamp").touch()  # which Snakemake leaves
    assert audit_release(release).verdict == "intact"
    shutil.rmtree(release / SIMULATIONS)
    forger.reseal()
    assert audit_release(release).verdict == "intact"


def flip(path, place, bit):
    content = bytearray(path.read_bytes())
    content[place % len(content)] ^= 1 << bit
    path.write_bytes(content)


@pytest.mark.slow
def test_one_flipped_bit_in_any_file_is_found(release):
    chance = random.Random(1)
    names = sorted(read_sums(release))
    chosen = {name.split("/")[0]: name for name in names}  # one of every folder, and the files
    for name in dict.fromkeys([*chosen.values(), *chance.sample(names, 12)]):
        place = chance.randrange(10**9), chance.randrange(8)
        flip(release / name, *place)
        assert name in found(release, Kind.ALTERED)
        flip(release / name, *place)
    assert audit_release(release).verdict == "intact"


def test_flipped_bit_in_a_shard_names_clips_of_that_shard_only(release):
    shard = row_of(release, CLIP)["shard"]
    flip(release / shard, (release / shard).stat().st_size // 3, 2)
    ((where, clips),) = found(release, Kind.ALTERED).items()
    manifest = pq.read_table(release / "manifest.parquet").to_pylist()
    assert where == shard
    assert clips <= {row["video"] for row in manifest if row["shard"] == shard}


def test_swapped_shards_are_both_named(forger, release):
    first, second = sorted((release / "data").iterdir())[:2]
    aside = first.rename(release.parent / "aside")
    second.rename(first)
    aside.rename(second)
    one, other = f"data/{first.name}", f"data/{second.name}"
    said = {finding.where: finding.what for finding in audit_release(release).of_kind(Kind.ALTERED)}
    assert said[one] == f"has the content of {other}" and said[other] == f"has the content of {one}"
    forger.reseal()
    assert {one, other} <= set(found(release, Kind.BROKEN))


def draw_anew(forger, row, positions, change=lambda pixels: None):
    """Change images of a clip's shard, by their rows, and encode them as no release does."""

    def edit(rows):
        for position in positions:
            image = rows[position]["image"]
            pixels = cv2.imdecode(np.frombuffer(image["bytes"], np.uint8), cv2.IMREAD_COLOR)
            change(pixels)
            encoded = cv2.imencode(".png", pixels, [cv2.IMWRITE_PNG_COMPRESSION, 9])[1]
            image["bytes"] = encoded.tobytes()

    forger.edit_rows(row["shard"], edit)


def test_one_changed_pixel_is_found_behind_new_sums(forger, release):
    def change(pixels):
        pixels[3, 4, 1] ^= 1

    row = row_of(release, CLIP)
    draw_anew(forger, row, [row["first_row"] + 2], change)
    for _ in range(2):
        assert found(release, Kind.ALTERED) == {row["shard"]: {CLIP}}
        forger.reseal()


def test_reencoded_images_alter_the_file_but_no_clip(forger, release):
    row = row_of(release, CLIP)
    draw_anew(forger, row, range(pq.read_metadata(release / row["shard"]).num_rows))
    audit = audit_release(release)
    (finding,) = audit.of_kind(Kind.ALTERED)
    assert finding.where == row["shard"] and "the pixels of its clips do not" in finding.what
    assert audit.clip_kinds()[CLIP] == []


LABELS = {"friction": 0.6, "material": "ivory-rib-knit", "split_by_simulation": "validation"}
LABELS |= {"floor": "polyester-mirror", "floor_roughness": 0.123}


@pytest.mark.default_cases(1)
@pytest.mark.parametrize(("column", "value"), LABELS.items())
def test_edited_label_is_found_however_well_the_sums_are_mended(forger, release, column, value):
    manifest = release / "manifest.parquet"
    assert row_of(release, CLIP)[column] != value
    forger.relabel(CLIP, **{column: value})
    assert "manifest.parquet" in found(release, Kind.ALTERED)
    forger.reseal()
    assert "manifest.parquet" in found(release, Kind.BROKEN)
    # Now also the digests that the manifest and the record of the sampling note.
    table = pq.read_table(manifest)
    rows = table.to_pylist()
    pq.write_table(attach_metadata(table, {"dataset_digest": dataset_digest(rows)}), manifest)
    names = read_contents(release).notes["sampled_columns"]
    digest = dataset_digest(sampled_rows(rows, names))
    other("metadata", dataset_digest=digest)(release / OF_SAMPLE)
    forger.reseal()
    assert CLIP in found(release, Kind.BROKEN)["manifest.parquet"]


@pytest.mark.parametrize(
    ("column", "value"), [("friction", 1.0), ("frame", 7), ("time_s", 3.0), ("stage_x_m", 0.1)]
)
def test_edited_label_of_an_image_is_found_behind_new_sums(forger, release, column, value):
    row = row_of(release, CLIP)
    forger.edit_rows(row["shard"], lambda rows: rows[row["first_row"] + 1].update({column: value}))
    forger.reseal()
    assert found(release, Kind.BROKEN)[row["shard"]] == {CLIP}


def test_dropped_file_is_missing(forger, release):
    shard = row_of(release, CLIP)["shard"]
    (release / shard).unlink()
    for _ in range(2):
        assert CLIP in found(release, Kind.MISSING)[shard]
        forger.reseal()  # the manifest still knows it
    (release / MANIFEST).unlink()
    assert MANIFEST in found(release, Kind.MISSING) and found(release, Kind.BROKEN)


def test_files_that_hubs_and_desktops_add_are_named_and_no_damage(release, capsys):
    (release / ".cache/huggingface").mkdir(parents=True)
    (release / ".cache/huggingface/link").symlink_to("/nowhere")
    for name in (".gitattributes", ".DS_Store", ".cache/huggingface/upload.lock"):
        (release / name).write_text("theirs")
    (release / "data/Thumbs.db").write_text("theirs")
    assert run(f"audit {release}") == 0
    said = capsys.readouterr().out
    assert "intact" in said and "DAMAGED" not in said and "broken chain" not in said
    listed = ".DS_Store, .cache, .gitattributes and 1 more"
    assert f"not part of the release, not looked at: {listed}" in said
    # Not so a shard: the card's pattern would load it.
    shard = next((release / "data").glob("*.parquet"))
    other = shard.with_name(shard.name.replace("-00000-", "-00099-"))
    shutil.copyfile(shard, other)
    assert set(found(release, Kind.UNEXPLAINED)) == {f"data/{other.name}"}


def edited(edit):
    """A change of a JSON file."""

    def change(path):
        content = json.loads(path.read_text())
        edit(content)
        path.write_text(json.dumps(content))

    return change


def other(*keys, **entries):
    """Other entries of a mapping in a JSON file."""
    return edited(lambda content: functools.reduce(dict.__getitem__, keys, content).update(entries))


def replaced(old, new):
    return lambda path: path.write_text(path.read_text().replace(old, new, 1))


def exchanged(path):
    """A simulation of another coefficient in the place of one."""
    shutil.copyfile(max(path.parent.glob("*.parquet")), path)


RENDER, NONE = "render/m05_f0300_r00_v00.parquet", "0" * 64
CARRIED = f"{SIMULATIONS}/m05_f0300_r00.parquet"
OF_SIMULATE, OF_RENDER, OF_SAMPLE = (
    f"records/{name}.record.json"
    for name in ("simulate/m05_f0300_r00.parquet", RENDER, "sample/manifest.parquet")
)
CALIBRATION, CONFIGURED = "records/calibrate/calibration.json", "records/config.json"
FABRICS, MANIFEST = "code/src/slipstitch/config/fabrics.json", "manifest.parquet"
SIMULATION, VIEW = ("m05_f0300_r00", ""), ("m05_f0300_r00", "v00")
FABRIC, ALL = ("m05", ""), ("", "")
#: What is changed behind new sums, and how -> a place of what is found, and how the ids of all
#: clips that this concerns begin and end.
FORGED = [
    (OF_SIMULATE, other(sha256=NONE), CARRIED, SIMULATION),
    (CARRIED, exchanged, CARRIED, SIMULATION),
    (CALIBRATION, replaced("true", "false"), CALIBRATION, ALL),
    (FABRICS, replaced("0.187", "0.188"), OF_SIMULATE, FABRIC),
    # The calibration chose among such settings, and every simulation was made from it.
    (CONFIGURED, other("simulation", time_step_s=0.01), f"{CALIBRATION}.record.json", ALL),
    (CONFIGURED, other("simulation", yaw_sd_deg=2.0), OF_SIMULATE, ALL),
    (OF_SIMULATE, other("provenance", "config", "simulation", time_step_s=1e-3), OF_SIMULATE,
     SIMULATION),
    (OF_RENDER, other("provenance", code_digest=NONE), OF_RENDER, VIEW),
    (OF_RENDER, other("provenance", "inputs", **{"results/simulate/m05_f0300_r00.parquet": NONE}),
     OF_RENDER, VIEW),
    (OF_RENDER, other("metadata", "surroundings", floor="polyester-mirror"), MANIFEST, VIEW),
    (OF_SAMPLE,
     edited(lambda one: one["provenance"]["inputs"].pop("results/sample/m05_f0300_r00.parquet")),
     OF_SAMPLE, SIMULATION),
    (OF_RENDER, other(provenance=None), OF_RENDER, VIEW),
    # Which clips are its, only it could have told.
    (OF_RENDER, edited(dict.clear), OF_RENDER, SIMULATION),
]  # fmt: skip


@pytest.mark.default_cases(4)
@pytest.mark.parametrize(("file", "change", "place", "concerned"), FORGED)
def test_a_forged_file_breaks_the_chain_of_its_clips_behind_new_sums(
    forger, release, file, change, place, concerned
):
    change(release / file)
    assert file in found(release, Kind.ALTERED)
    forger.reseal()
    broken = found(release, Kind.BROKEN)
    assert place in broken
    begin, end = concerned
    clips = {clip for clip in CLIPS if clip.startswith(begin) and clip.endswith(end)}
    assert set.union(*broken.values()) == clips


VIEWPOINTS = CONFIG.render.model_dump() | {"viewpoints": ["calibrated", "frontal", "side"]}
MOTION = {"frames": 60, "vertices_per_side": 11}
#: Sections that are others now -> stages that are stale.
CHANGED = [
    ({"sample": {"frames": 5, "test_fraction": 0.2}}, {"sample"}),
    ({"render": VIEWPOINTS}, {"sample"}),  # no shard for one more viewpoint
    # Simulations are told the step by the calibration: that is what has to be made anew first.
    ({"simulation": MOTION | {"time_step_s": 0.01}}, {"calibrate.calibration"}),
    ({"simulation": MOTION | {"yaw_sd_deg": 2.0}}, {"calibrate.calibration", "simulate"}),
]


@pytest.mark.parametrize(("sections", "stages"), CHANGED)
def test_changed_configuration_makes_stale_not_damaged(original, sections, stages):
    audit = audit_release(original, synthetic_chain.config(**sections))
    assert audit.verdict == "stale"
    assert {finding.where for finding in audit.findings} == stages


def test_stale_is_said_with_its_reason_and_can_be_allowed(original, tmp_path, capsys):
    write_config(synthetic_chain.config(**CHANGED[0][0]), tmp_path / "c")
    assert run(f"audit {original} --config {tmp_path}/c") == 1
    assert "sample.test_fraction: 0.1 -> 0.2" in capsys.readouterr().out
    assert run(f"audit {original} --config {tmp_path}/c --allow-stale") == 0


def released(config, folder, out=None):
    """The release of a chain made up in a folder, found to be intact."""
    release = (out or folder) / "release"
    write_release(config, synthetic_chain.write(config, folder), release, ROOT)
    audit = audit_release(release)
    assert audit.verdict == "intact", audit.findings[:3]
    return release


@pytest.mark.slow
def test_drawn_videos_and_a_second_training_set_are_followed(tmp_path):
    """Not every simulation from every viewpoint in every texture, and floors of two kinds."""
    render = {"test_viewpoint_videos": 3, "reflective_floors": ["ceramic", "aluminium"]}
    config = CONFIG.model_copy(update={"render": CONFIG.render.model_copy(update=render)})
    rows = pq.read_table(released(config, tmp_path) / "manifest.parquet").to_pylist()
    assert sum(row["viewpoint_role"] == "test" for row in rows) == 3
    assert {row["floor"] for row in rows if row["floor_role"] == "test"} <= {"ceramic", "aluminium"}


@pytest.mark.slow
def test_cloths_between_simulations_are_followed_to_all_of_these(tmp_path, monkeypatch):
    monkeypatch.setattr(view, "STRAIN_MAX", 1.0)  # drawn cloths are no sheets
    monkeypatch.setattr(interpolation, "FROM_FRICTION", 0.0)
    render = CONFIG.render.model_dump() | {
        **{"viewpoints": ["bench_1", "bench_2"], "test_viewpoints": []},
        **{"interpolation": {"share": 1.0}, "verified_images": 0},  # drawn images: not rectified
    }
    config = synthetic_chain.config(render=render, train={"splits": ["by_simulation"]})
    release = released(config, tmp_path)
    rows = pq.read_table(release / "manifest.parquet").to_pylist()
    between = [row for row in rows if row["interpolated"]]
    assert {row["split_by_simulation"] for row in between} <= {"train", None}  # None: test-only
    shown, contents = interpolations(config), read_contents(release)
    for row in between:
        one = shown[row["simulation"], row["viewpoint_id"]]
        assert row["friction"] == one.friction
        behind = {Path(each.path).stem for each in contents.of_stage(row, "simulate")}
        assert behind == set(one.weights)


@pytest.fixture(scope="module")
def criticised(tmp_path_factory):
    """A working folder in which a case was criticised; also the same model at other places."""
    folder = tmp_path_factory.mktemp("law") / "run"
    folder.mkdir()
    with contextlib.chdir(folder):
        case, out = ROOT / "data/cases/surrogate_anisotropic", "results/criticise/x/verdict.json"
        assert run(f"criticise {case} --replicates 50 --out {out} --model {OWN_LAW}") == 0
        for place in ("laws/law.yaml", "../law.yaml"):
            Path(place).parent.mkdir(exist_ok=True)
            shutil.copyfile(OWN_LAW, place)
    return folder


OWN_LAW = "results/criticise/x/extended_model.yaml"


LAWS = {OWN_LAW: "criticise/x/extended_model.yaml"}
LAWS |= {"laws/law.yaml": "laws/law.yaml", "../law.yaml": "law.yaml"}


@pytest.mark.slow
@pytest.mark.parametrize(("model", "carried"), LAWS.items())
def test_release_takes_the_friction_law_along_and_the_audit_follows_it(
    criticised, tmp_path, monkeypatch, model, carried
):
    """The law that a criticism found, and laws that lie in the working folder or outside."""
    folder = Path(shutil.copytree(criticised, tmp_path / "run"))
    shutil.copyfile(criticised.parent / "law.yaml", tmp_path / "law.yaml")
    monkeypatch.chdir(folder)
    config = synthetic_chain.config(
        grid={"materials": ["gray-interlock"], "frictions": [0.1, 0.6], "replicates": 2},
        simulation={"frames": 60, "vertices_per_side": 11, "model": model},
        render={"pixels": 16, "textures": ["stripes"]},
    )
    release = released(config, folder, tmp_path)
    assert (release / "records" / carried).read_bytes() == Path(model).read_bytes()
    assert f"(records/{carried})" in (release / "README.md").read_text()
    made_again = auditing._configuration(read_contents(release), config, tmp_path)
    law = load_config(made_again).simulation.model
    assert Path(law) == release / "records" / carried


def test_odd_content_of_a_record_or_a_calibration_is_a_finding_and_stops_no_audit(forger, release):
    (of_render,) = forger.edit_records(RENDER, lambda one: one["metadata"].update(pose=[1]))
    calibration = "records/calibrate/calibration.json"
    forger.edit_json(calibration, lambda one: one["settings"].update(gone=1))
    assert {of_render, calibration} <= set(found(release, Kind.ALTERED))
    forger.reseal()
    broken = audit_release(release).of_kind(Kind.BROKEN)
    told = [one for one in broken if "settings of its calibration: simulation.gone" in one.what]
    assert len(told) == len(simulations(CONFIG))


def test_changed_entry_of_a_catalogue_makes_stale_not_damaged(original, monkeypatch):
    fabrics = {name: load_fabric(name) for name in fabric_names()}
    fabrics["ivory-rib-knit"] = fabrics["ivory-rib-knit"].scaled(1.1, 1.0, 1.0)
    monkeypatch.setattr("slipstitch.physics.fabric._catalogue", lambda: fabrics)
    monkeypatch.setitem(FLOORS, "ceramic", replace(FLOORS["ceramic"], albedo=(0.4, 0.5)))
    audit = audit_release(original)
    said = {finding.where: finding for finding in audit.findings}
    assert audit.verdict == "stale" and said.keys() == {"simulate", "render"}
    assert "catalogue.fabrics.ivory-rib-knit: " in said["simulate"].what
    assert len(said["simulate"].clips) == 144 / len(CONFIG.grid.materials)


def test_changed_code_makes_its_stage_stale(original, monkeypatch):
    now = currency.current_digest

    def changed(stage, root=None, versions=None):
        return NONE if stage == "render" and root is None else now(stage, root, versions)

    monkeypatch.setattr(currency, "current_digest", changed)
    audit = audit_release(original)
    assert audit.verdict == "stale"
    assert [(one.where, one.what) for one in audit.findings] == [("render", "its code has changed")]


COMMIT = {"git_commit": "ab" * 20, "git_dirty": False}


def hold_in_every_commit(monkeypatch, write):
    """Let any commit be known, with what `write` puts into the folder."""
    folder = tempfile.TemporaryDirectory()
    write(Path(folder.name))
    monkeypatch.setattr(lineage_check, "_unpacked", lambda checkout, commit: folder)


def test_commit_that_holds_other_code_is_found(forger, monkeypatch):
    def other_code(folder):
        shutil.copytree(ROOT / "src/slipstitch", folder / "src/slipstitch")
        (folder / "src/slipstitch/physics/simulation/trajectory.py").write_text("# other\n")

    forger.edit_records("*", lambda one: (one["provenance"] or {}).update(COMMIT))
    forger.reseal()
    said = audit_release(forger.release).notes
    assert any("abababababab is not in this checkout" in note for note in said)
    hold_in_every_commit(monkeypatch, other_code)
    assert len(found(forger.release, Kind.BROKEN)["simulate"]) == 144


def test_older_sources_are_not_compared(forger, monkeypatch):
    """Of a release, or a commit, of before the stages that are known now."""

    def older(folder):
        (folder / "src/slipstitch/sample").mkdir(parents=True)

    of_then = COMMIT | {"code_digest": NONE}
    forger.edit_records("*", lambda one: (one["provenance"] or {}).update(of_then))

    def with_former_keys(one):  # which are constants now
        config = one["provenance"]["config"]
        config.get("simulation", {}).update(former=1)
        config.get("render", {}).get("bench_camera", {}).update(former=1)

    for stage in ("simulate", "render"):
        forger.edit_records(f"{stage}/*", with_former_keys)
    (forger.release / "code/src/slipstitch/dataset").rename(forger.release / "code/src/sample")
    forger.reseal()
    hold_in_every_commit(monkeypatch, older)
    audit = audit_release(forger.release)
    assert audit.verdict == "stale", audit.findings[:3]
    older_ones = {note.partition(" is of")[0] for note in audit.notes}
    assert {"code/src", "commit abababababab"} <= older_ones


@pytest.mark.parametrize("known", [True, False])
def test_simulations_that_quote_another_convergence_study_are_stale(
    forger, monkeypatch, tmp_path, known
):
    """They are no others for it; what they quote must be in the commit that made them."""
    former = tmp_path / MEASURED.name
    former.write_text(MEASURED.read_text().replace('"mean_distance_m": 0.001', '"mean_m": 1'))

    def of_commit(folder):
        shutil.copytree(ROOT / "src/slipstitch", folder / "src/slipstitch")
        if known:
            shutil.copy2(former, folder / "src/slipstitch/physics/simulation")

    def quote(record):
        (record["provenance"] or {}).update(COMMIT)
        if "convergence" in record["metadata"]:
            record["metadata"]["convergence"]["table_sha256"] = file_digest(former)

    forger.edit_records("*", quote)
    forger.reseal()
    hold_in_every_commit(monkeypatch, of_commit)
    audit = audit_release(forger.release)
    (stale,) = audit.of_kind(Kind.STALE)
    assert stale.where == "simulate" and "another convergence study" in stale.what
    assert len(stale.clips) == 144
    broken = [(finding.where, len(finding.clips)) for finding in audit.of_kind(Kind.BROKEN)]
    assert broken == ([] if known else [("simulate", 144)])


FOREIGN = {
    None: "not a release: no readable SHA256SUMS",
    "hello\n": "line 1: not '<SHA-256>",
    "": "SHA256SUMS: empty",
    f"{NONE}  ../x\n": "is outside the release",
    f"{NONE}  a.txt\n": "not a release of Slipstitch: SHA256SUMS names no manifest.parquet",
}


@pytest.mark.parametrize(("sums", "problem"), FOREIGN.items())
def test_half_written_or_foreign_folder_is_bad_input(tmp_path, capsys, sums, problem):
    assert "no such folder" in refused(capsys, ["audit", tmp_path / "folder"])
    (tmp_path / "data").mkdir()
    if sums is not None:
        (tmp_path / "SHA256SUMS").write_text(sums)
    assert problem in refused(capsys, ["audit", tmp_path])


def test_command_answers_machines_and_people(release, tmp_path, capsys):
    outcome, page = tmp_path / "audit.json", tmp_path / "audit.html"
    assert run(f"audit {release} --json {outcome} --page {page}") == 0
    assert "intact: every file" in capsys.readouterr().out
    assert json.loads(outcome.read_text())["verdict"] == "intact"
    (release / "LICENSE").write_text("none")
    assert run(f"audit {release} --json - --page {page}") == 1
    content = json.loads(capsys.readouterr().out)
    assert (content["verdict"], content["counts"]["altered"]) == ("damaged", 1)
    assert content["findings"][0]["where"] == "LICENSE"
    html = page.read_text(encoding="utf-8")
    assert "LICENSE" in html and "DAMAGED" in html and not re.search(r"(src|href)=", html)
    assert "inside the release" in refused(capsys, f"audit {release} --json {release}/audit.json")


def test_story_of_a_clip_names_every_link(original, capsys):
    assert run(f"audit {original} --explain {CLIP}") == 0
    story = capsys.readouterr().out
    stages = ("sample/m05_f0300_r00", "render/m05_f0300_r00_v00", "simulate/m05_f0300_r00")
    for part in (
        *(f"results/{name}.parquet" for name in stages),
        "results/calibrate/calibration.json",
        "fabric gray-interlock (same as the current one)",
        *("friction 0.3", "equal to the decoded pixels", "by_simulation: ", "yaw_deg"),
    ):
        assert part in story
    assert "v01.parquet" not in story
    assert "NOT" not in story.replace("NOT the current code", "")
    unknown = refused(capsys, f"audit {original} --explain m99")
    assert "no clip 'm99'; ids look like m" in unknown


def test_story_says_where_the_chain_breaks_and_the_digest_of_other_pixels(forger, release, capsys):
    other(sha256=NONE)(release / OF_RENDER)
    decoded = row_of(release, CLIP)["pixels_sha256"]
    forger.relabel(CLIP, pixels_sha256=NONE)
    run(f"audit {release} --explain {CLIP}")
    story = capsys.readouterr().out
    assert f"results/{RENDER} (DIFFERENT from the next)" in story
    assert f"NOT equal to the decoded pixels ({decoded})" in story


def test_story_is_told_of_odd_records_and_sources_too(forger, release):
    forger.edit_records(RENDER, lambda one: one["provenance"].update(git_commit=3))
    forger.edit_json(
        "records/calibrate/calibration.json",
        lambda one: [check.pop("met") for check in one["checks"]],
    )
    forger.edit_json(FABRICS, lambda one: one["fabrics"].update({"gray-interlock": [1]}))
    story = auditing.explain(read_contents(release), CLIP)
    for part in ("commit 3", "checks: unreadable", "fabric gray-interlock: not in the release's"):
        assert part in story


def test_comparison_of_a_rebuilt_clip_says_by_how_much_it_differs():
    first = np.zeros((3, 8, 8, 3), np.uint8)
    second = first.copy()
    same = auditing.compare("a", first, second, True)
    assert same.same and same.psnr_db is None
    told = auditing.compare("a", first, second, True, ("solver of results/simulate/a.parquet",))
    assert not told.same
    assert "TELL OTHERWISE: solver of results/simulate/a.parquet" in auditing.in_words(told)
    second[1, 2, 3, 0] = 200
    other = auditing.compare("a", first, second, True)
    assert (other.same_pixels, other.images_differing, other.largest_difference) == (False, 1, 200)
    expected = 10 * np.log10(255**2 / (200**2 / first.size))
    assert other.psnr_db == pytest.approx(expected, abs=0.01)


def test_a_law_that_lay_elsewhere_is_no_difference_of_a_simulation_made_again(tmp_path):
    metadata = {"settings": {"frames": 9, "model": "law.yaml"}, "extended_model": {"law": 1}}
    recorded = Artefact("results/simulate/a.parquet", "", metadata=metadata)
    made = tmp_path / "a.parquet"
    for settings, told in (({"frames": 9}, []), ({"frames": 8}, [f"settings of {recorded.path}"])):
        again = metadata | {"settings": settings | {"model": "/release/records/law.yaml"}}
        write_parquet(pa.table({"frame": [0]}), made, again)
        assert auditing._differing(recorded, made) == told


def test_clip_without_whole_records_is_not_rebuilt(forger, release):
    edited(dict.clear)(release / OF_RENDER)
    with pytest.raises(BadInput, match=f"the records behind {CLIP} are not whole"):
        auditing.rebuild(read_contents(release), CLIP)
