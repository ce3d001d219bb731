"""A careful forger against the audit: everything mended that can be computed, and yet found."""

import io
import shutil
import subprocess
import zlib
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from PIL import Image
from support import synthetic_chain
from support.forger import Forger, chunk

from slipstitch.cli.main import main
from slipstitch.dataset.audit import staleness
from slipstitch.dataset.audit.auditing import audit_release
from slipstitch.dataset.audit.contents import read_contents
from slipstitch.dataset.audit.findings import Kind
from slipstitch.dataset.release.assembly import write_release
from slipstitch.dataset.release.signature import verify

ROOT = Path(__file__).parents[2]
CONFIG = synthetic_chain.config(
    grid={
        "materials": ["gray-interlock", "ivory-rib-knit"],
        "frictions": [0.1, 0.3],
        "replicates": 2,
    },
    render={
        "pixels": 16,
        "viewpoints": ["calibrated"],
        "textures": ["stripes", "tartan"],
        "floors": ["matte", "ceramic"],
    },
)
CALIBRATION = "records/calibrate/calibration.json"
VERIFICATION = "records/render/verification.json"
OF_SIMULATION = "records/simulate/m05_f0300_r00.parquet.record.json"
OF_SHARD = "records/render/m05_f0300_r00_v00.parquet.record.json"
pytestmark = pytest.mark.xdist_group("forgeries")


@pytest.fixture(scope="module")
def original(tmp_path_factory):
    folder = tmp_path_factory.mktemp("forgeries")
    results = synthetic_chain.write(CONFIG, folder)
    key = folder / "key"
    subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", str(key)], check=True)
    write_release(CONFIG, results, folder / "release", ROOT, key)
    return folder / "release"


@pytest.fixture
def release(original, tmp_path):
    """A copy that a test may forge."""
    copy = Path(shutil.copytree(original, tmp_path / "release"))
    for path in copy.rglob("*"):
        path.chmod(path.stat().st_mode | 0o200)
    return copy


@pytest.fixture
def forger(release, original):
    return Forger(release, original)


def places(release: Path) -> dict[str, str]:
    """Where the audit finds anything -> what."""
    return {finding.where: finding.what for finding in audit_release(release).findings}


def first_shard(release: Path) -> str:
    return f"data/{sorted((release / 'data').iterdir())[0].name}"


# --- the card and what else describes the data


def tested_part_under_train(forger):
    """A part that tests by_simulation, loaded as training data."""
    rows = pq.read_table(forger.release / "manifest.parquet").to_pylist()
    part = next(row["part"] for row in rows if row["split_by_simulation"] == "test")
    head = "- config_name: by_simulation\n  data_files:\n  - split: train\n    path:\n"
    forger.edit_text("README.md", head, f"{head}    - data/{part}-*.parquet\n")


def other_figure_on_the_card(forger):
    forger.edit_text("README.md", "GPL-3.0-or-later (", "MIT (")


def other_croissant(forger):
    forger.edit_text("croissant.json", "GPL-3.0-or-later", "MIT")


def other_crate(forger):
    forger.edit_text("ro-crate-metadata.json", "slipstitch render", "another renderer")


def other_preview(forger):
    path = forger.release / "previews/through_time.png"
    pixels = np.array(Image.open(path))
    pixels[60, 200] ^= 1
    Image.fromarray(pixels).save(path)


def bytes_behind_a_preview(forger):
    path = forger.release / "previews/through_time.png"
    path.write_bytes(path.read_bytes() + b"hidden")


def other_title(forger):
    forger.edit_json("records/release.json", lambda one: one["facts"].update(title="Mine"))


def other_grid(forger):
    def edit(rows):
        rows[-1]["seed"] += 1

    forger.edit_rows("records/grid.parquet", edit)


def other_licence(forger):
    (forger.release / "LICENSE").write_text("mine")


# --- images and tables


def edit_image(forger, change) -> None:
    def edit(rows):
        image = rows[2]["image"]
        image["bytes"] = change(image["bytes"])

    forger.edit_rows(first_shard(forger.release), edit)


def saved(picture: Image.Image, kind: str) -> bytes:
    stream = io.BytesIO()
    picture.save(stream, kind)
    return stream.getvalue()


def opened(data: bytes) -> Image.Image:
    return Image.open(io.BytesIO(data))


def rgba_images(forger):
    edit_image(forger, lambda data: saved(opened(data).convert("RGBA"), "PNG"))


def bmp_images(forger):
    edit_image(forger, lambda data: saved(opened(data), "BMP"))


def bytes_behind_an_image(forger):
    edit_image(forger, lambda data: data + b"hidden")


def chunk_in_an_image(forger):
    edit_image(forger, lambda data: data[:33] + chunk(b"tEXt", b"a\0hidden") + data[33:])


def lines_below_an_image(forger):
    def change(data):
        pixels = np.asarray(opened(data))
        lines = b"".join(b"\0" + line.tobytes() for line in pixels) + b"hidden"
        body = chunk(b"IDAT", zlib.compress(lines)) + chunk(b"IEND", b"")
        return data[:33] + body

    edit_image(forger, change)


def other_file_name(forger):
    def edit(rows):
        rows[0]["image"]["path"] = "mine.png"

    forger.edit_rows(first_shard(forger.release), edit)


def column_in_a_shard(forger):
    forger.edit_table(
        first_shard(forger.release),
        lambda table: table.append_column("more", pa.array([0] * len(table))),
    )


def column_in_the_manifest(forger):
    forger.edit_table(
        "manifest.parquet", lambda table: table.append_column("more", pa.array([0] * len(table)))
    )


def bytes_in_a_shard(forger):
    """Between the last column and the footer: no column claims them."""
    path = forger.release / first_shard(forger.release)
    data = path.read_bytes()
    footer = 8 + int.from_bytes(data[-8:-4], "little")
    path.write_bytes(data[:-footer] + b"hidden" + data[-footer:])


def further_shard(forger):
    """The card's pattern would load it."""
    shard = forger.release / first_shard(forger.release)
    copy = shard.with_name(shard.name.replace("-00000-", "-00099-"))
    shutil.copyfile(shard, copy)


def further_file(forger):
    (forger.release / "records/notes.json").write_text("{}")


def other_texture(forger):
    def edit(rows):
        rows[0]["texture"], rows[0]["texture_id"] = "tartan", "t01"

    forger.edit_rows("manifest.parquet", edit)


def other_pose(forger):
    forger.edit_rows("manifest.parquet", lambda rows: rows[0].update(pose_yaw_deg=3.0))


# --- what the verification and the calibration say


def psnr_of_60_db(forger):
    def edit(content):
        content["lowest_psnr_db"] = 60.0
        for one in content["comparisons"]:
            one["psnr_db"] = 60.0

    forger.edit_json(VERIFICATION, edit)


def lowest_ssim(forger):
    forger.edit_json(VERIFICATION, lambda content: content.update(lowest_ssim=1.0))


def other_verified_images(forger):
    def edit(content):
        content["comparisons"] = content["comparisons"][:1]
        content.update(
            images=1,
            lowest_psnr_db=content["comparisons"][0]["psnr_db"],
            lowest_ssim=content["comparisons"][0]["ssim"],
        )

    forger.edit_json(VERIFICATION, edit)


def other_composed_image(forger):
    """The direct render in place of the composed one: equal, and the figures with them."""

    def edit(content):
        for one in content["comparisons"]:
            one.update(composed_png=one["direct_png"], psnr_db=168.13080360867911, ssim=1.0)
        content.update(lowest_psnr_db=168.13080360867911, lowest_ssim=1.0)

    forger.edit_json(VERIFICATION, edit)


def calibration_errors_of_0(forger):
    def edit(content):
        for check in content["checks"]:
            check.update(error=0.0, measured=check["theory"])

    forger.edit_json(CALIBRATION, edit)


def calibration_results_of_theory(forger):
    def edit(content):
        for run in content["experiments"]:
            result = run["result"]
            result |= {key: result[f"theory_{key}"] for key in result if f"theory_{key}" in result}
            run["result"] = result
        for check in content["checks"]:
            if check["theory"]:
                check.update(error=0.0, measured=check["theory"])

    forger.edit_json(CALIBRATION, edit)


def other_theory(forger):
    def edit(content):
        for run in content["experiments"]:
            if run["protocol"] == "flat-drag":
                run["result"]["theory_pull_over_weight"] *= 1.001

    forger.edit_json(CALIBRATION, edit)


def strip_error_of_0(forger):
    forger.edit_json(CALIBRATION, lambda one: one["strip"]["trials"][0].update(strain_error=0.0))


# --- configuration and records together


def finer_mesh(forger):
    forger.replace_everywhere('"vertices_per_side": 11', '"vertices_per_side": 21')


def tighter_tolerance(forger):
    forger.replace_everywhere('"friction_tolerance": 0.0005', '"friction_tolerance": 0.0001')


def other_settings_in_one_record(forger):
    forger.edit_json(OF_SIMULATION, lambda one: one["metadata"]["settings"].update(settle_s=9.0))


def setting_left_out(forger):
    forger.edit_records(
        "simulate/*", lambda one: one["provenance"]["config"]["simulation"].pop("settle_s")
    )


def small_residuals(forger):
    forger.edit_records(
        "simulate/*", lambda one: one["metadata"]["solver"].update(largest_residual=1e-9)
    )


def few_steps(forger):
    forger.edit_records("simulate/*", lambda one: one["metadata"]["solver"].update(steps=4))


def without_calibration(forger):
    forger.edit_records("simulate/*", lambda one: one["provenance"]["inputs"].clear())


def other_camera(forger):
    def edit(record):
        for frame in record["metadata"]["camera"]["frames"].values():
            frame["focal_px"] *= 1.01

    forger.edit_records("render/*_v00.parquet.record.json", edit)


def points_of_no_cloth(forger):
    def edit(record):
        for places in record["metadata"]["marked_points_m"].values():
            places[-3] += 0.15  # of 0.2 m

    forger.edit_records("render/*_v00.parquet.record.json", edit)


def other_trajectory(forger):
    forger.edit_json(OF_SHARD, lambda one: one["metadata"].update(trajectory_sha256="0" * 64))


def other_stage(forger):
    forger.edit_json(OF_SHARD, lambda one: one["provenance"].update(stage="sample"))


def other_seed_of_the_draw(forger):
    forger.edit_records("render/*", lambda one: one["provenance"].update(seed=2))


def other_numpy(forger):
    forger.edit_records("*", lambda one: one["provenance"]["versions"].update(numpy="2.0.0"))


def other_warp_and_lock(forger):
    """Found by the digest of the code, which is of this version too."""
    installed = staleness.installed_version("warp-lang")
    forger.edit_records(
        "*", lambda one: one["provenance"]["versions"].update({"warp-lang": "1.0.0"})
    )
    forger.edit_text("code/envs/requirements.lock", f"warp-lang=={installed}", "warp-lang==1.0.0")


def other_snakefile(forger):
    forger.edit_text("code/Snakefile", "rule all:", "rule everything:")


def other_rule(forger):
    forger.edit_text("code/rules/simulate.smk", "threads: 1", "threads: 2")


def other_lock(forger):
    forger.edit_text("code/envs/requirements.lock", "absl-py==", "absl-py==0.")


FORGERIES = {
    tested_part_under_train: "README.md",
    other_figure_on_the_card: "README.md",
    other_croissant: "croissant.json",
    other_crate: "ro-crate-metadata.json",
    other_preview: "previews/through_time.png",
    bytes_behind_a_preview: "previews/through_time.png",
    other_title: "records/release.json",
    other_grid: "records/grid.parquet",
    other_licence: "LICENSE",
    rgba_images: first_shard,
    bmp_images: first_shard,
    bytes_behind_an_image: first_shard,
    chunk_in_an_image: first_shard,
    lines_below_an_image: first_shard,
    other_file_name: first_shard,
    column_in_a_shard: first_shard,
    column_in_the_manifest: "manifest.parquet",
    bytes_in_a_shard: first_shard,
    further_shard: lambda release: first_shard(release).replace("-00000-", "-00099-"),
    further_file: "records/notes.json",
    other_texture: "manifest.parquet",
    other_pose: "manifest.parquet",
    psnr_of_60_db: VERIFICATION,
    lowest_ssim: VERIFICATION,
    other_verified_images: VERIFICATION,
    other_composed_image: VERIFICATION,
    calibration_errors_of_0: CALIBRATION,
    calibration_results_of_theory: CALIBRATION,
    other_theory: CALIBRATION,
    strip_error_of_0: CALIBRATION,
    finer_mesh: OF_SIMULATION,
    tighter_tolerance: OF_SIMULATION,
    other_settings_in_one_record: OF_SIMULATION,
    setting_left_out: OF_SIMULATION,
    small_residuals: OF_SIMULATION,
    few_steps: OF_SIMULATION,
    without_calibration: OF_SIMULATION,
    other_camera: OF_SHARD,
    points_of_no_cloth: OF_SHARD,
    other_trajectory: OF_SHARD,
    other_stage: OF_SHARD,
    other_seed_of_the_draw: OF_SHARD,
    other_numpy: OF_SIMULATION,
    other_warp_and_lock: OF_SIMULATION,
    other_snakefile: "code/Snakefile",
    other_rule: "code/rules/simulate.smk",
    other_lock: "code/envs/requirements.lock",
}


def test_an_intact_signed_release_is_intact(original):
    audit = audit_release(original, CONFIG)
    assert audit.findings == []
    assert audit.verdict == "intact"


def test_mending_what_is_not_forged_makes_no_finding(forger):
    """Else the forgeries below might be found by the forger's own traces."""
    forger.cover_up()
    assert places(forger.release) == {}


@pytest.mark.parametrize("forge", FORGERIES, ids=lambda forge: forge.__name__)
def test_forgery_is_found_and_named(forger, forge):
    place = FORGERIES[forge]
    place = place if isinstance(place, str) else place(forger.release)
    forge(forger)
    forger.cover_up(place)
    audit = audit_release(forger.release)
    assert place in {finding.where for finding in audit.findings}
    assert audit.verdict in ("damaged", "stale")


def possible_residuals(forger):
    """Nothing in a release computes these; they are possible."""
    forger.edit_records(
        "simulate/*", lambda one: one["metadata"]["solver"].update(largest_residual=4.1e-4)
    )


def signers(folder: Path, key: Path) -> Path:
    path = folder / "allowed_signers"
    path.write_text(f"jane@example.org {key.with_suffix('.pub').read_text()}")
    return path


def test_only_a_signature_or_a_digest_from_elsewhere_tells_the_rest(forger, original, tmp_path):
    published = read_contents(original).sums_sha256
    possible_residuals(forger)
    forger.cover_up()
    assert places(forger.release) == {}
    audit = audit_release(forger.release, expected=published)
    assert [finding.where for finding in audit.findings] == ["SHA256SUMS"]
    believed = signers(tmp_path, original.parent / "key")
    audit = audit_release(forger.release, signers=believed)
    assert [finding.where for finding in audit.findings] == ["SHA256SUMS.sig"]
    assert len(audit.findings[0].clips) == len(audit.clips)


def test_signature_says_who_vouches(original, tmp_path, capsys):
    believed = signers(tmp_path, original.parent / "key")
    assert main(["audit", str(original), "--verify", str(believed)]) == 0
    assert "signed by jane@example.org" in capsys.readouterr().out


def test_signature_of_a_stranger_is_none(original, tmp_path):
    key = tmp_path / "key"
    subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", str(key)], check=True)
    signer, problem = verify(original, signers(tmp_path, key))
    assert signer is None
    assert "not signed by any of the signers" in problem


def test_release_that_is_not_signed_is_not_verified(release, tmp_path):
    (release / "SHA256SUMS.sig").unlink()
    believed = tmp_path / "signers"
    believed.write_text("jane@example.org ssh-ed25519 AAAA\n")
    assert verify(release, believed) == (None, "the release is not signed")


@pytest.mark.parametrize("words", [["--sign", "none"], ["--verify", "none"]])
def test_without_key_signers_or_tool_is_one_line(original, capsys, monkeypatch, words):
    config = ["--config", str(original.parent / "results/config.json")]
    out = ["--results", str(original.parent / "results"), "--out-dir", "mine"]
    command = ["release", *config, *out] if words[0] == "--sign" else ["audit", str(original)]
    assert main([*command, *words]) == 2
    assert "none: no such file" in capsys.readouterr().err
    monkeypatch.setattr("shutil.which", lambda name: None)
    assert main([*command, *words]) == 2
    said = capsys.readouterr().err
    assert "ssh-keygen is not installed" in said
    assert said.count("\n") == 1


def test_code_that_is_not_the_commit_s_is_named(release, tmp_path):
    """In a checkout that has the commit, also what no stage's digest covers."""
    repository = Path(shutil.copytree(release / "code", tmp_path / "repository"))

    def git(*words: str) -> str:
        command = ["git", "-C", str(repository), "-c", "user.name=a", "-c", "user.email=a@b"]
        answer = subprocess.run([*command, *words], check=True, capture_output=True, text=True)
        return answer.stdout.strip()

    git("init", "-q")
    git("add", "--force", ".")
    git("commit", "-qm", "All of it")
    contents = read_contents(release)
    contents.release["provenance"] |= {"git_commit": git("rev-parse", "HEAD"), "git_dirty": False}
    assert staleness.copied_code(contents, repository) == []
    Forger(release, release).edit_text("code/Snakefile", "rule all:", "rule everything:")
    (release / "code/envs/requirements.lock").unlink()
    (release / "code/rules/more.smk").write_text("")
    contents.sums["code/rules/more.smk"] = "0" * 64
    found = staleness.copied_code(contents, repository)
    assert {finding.where for finding in found} == {
        "code/Snakefile",
        "code/envs/requirements.lock",
        "code/rules/more.smk",
    }
    assert {finding.kind for finding in found} == {Kind.BROKEN}
