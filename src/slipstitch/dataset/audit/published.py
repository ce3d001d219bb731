"""The audit of a published folder: its files, and its models back to their simulations."""

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from slipstitch.base.errors import BadInput, first_line
from slipstitch.base.provenance import file_digest, read_json, read_metadata, read_parquet
from slipstitch.base.provenance.reading import SIDECAR_SUFFIX
from slipstitch.dataset.audit.admission import check_entries, limited_memory
from slipstitch.dataset.audit.audit_page import printable
from slipstitch.dataset.audit.findings import Finding, Kind, sorted_findings
from slipstitch.dataset.audit.scored import FURTHER, SCORES, SCORES_OF, and_more, compare
from slipstitch.dataset.audit.staleness import other_code
from slipstitch.dataset.manifest import MANIFEST, read_manifest
from slipstitch.dataset.release.records import Artefact
from slipstitch.film.measure import SHIPPED

#: Of a folder that `slipstitch publish` wrote.
INDEX = "published.json"
_DATASET, _READINGS = "dataset", "calibration_readings/"
_READ_ELSEWHERE = "/readings.parquet"
_DIGESTS, _LINEAGE = f"{_DATASET}/digests.json", f"{_DATASET}/lineage.json"
_SIMULATED, _TRAINED, _AVERAGED = "/simulate/", "/train/", "/instrument/"


@dataclass(frozen=True)
class Chain:
    """What a published model comes from, as far as its records tell.

    Attributes
    ----------
    weights, sha256 : str
        Published file, and its digest.
    shipped : bool
        Whether these are the weights that come with Slipstitch.
    shards : dict
        Files of images that it was trained and calibrated on -> SHA-256.
    behind : dict
        Everything that these were made from -> SHA-256.
    """

    weights: str
    sha256: str
    shipped: bool
    shards: dict[str, str]
    behind: dict[str, str]

    @property
    def simulations(self) -> dict[str, str]:
        """The simulations among it."""
        return {name: digest for name, digest in self.behind.items() if _SIMULATED in name}


@dataclass(frozen=True)
class PublishedAudit:
    """The outcome: ``intact`` without findings, else ``damaged``."""

    name: str
    files: int
    findings: list[Finding]
    chains: list[Chain]
    notes: list[str]

    @property
    def verdict(self) -> str:
        """``intact`` or ``damaged``."""
        return "damaged" if self.findings else "intact"

    def as_json(self) -> dict[str, Any]:
        """The outcome as JSON can hold it."""
        return {
            "published": self.name,
            "verdict": self.verdict,
            "files": self.files,
            "findings": [asdict(finding) for finding in self.findings],
            "models": [asdict(chain) | {"simulations": chain.simulations} for chain in self.chains],
            "notes": self.notes,
        }

    def as_text(self) -> str:
        """The outcome as lines."""
        lines = [f"{self.name}: {self.verdict}, {self.files} files checked"]
        lines += [f"  {one.kind.value}: {one.where}: {one.what}" for one in self.findings]
        for chain in self.chains:
            ships = ", the instrument that ships" if chain.shipped else ""
            lines.append(f"{chain.weights}: {chain.sha256}{ships}")
            reached = f"the digests of {len(chain.simulations)} simulations"
            lines.append(
                f"  from {len(chain.shards)} files of images, from "
                + (reached if chain.simulations else "simulations whose digests are not published")
            )
        return "\n".join(map(printable, [*lines, *(f"note: {note}" for note in self.notes)]))


def audit_published(folder: Path) -> PublishedAudit:
    """Audit a folder that `slipstitch publish` wrote.

    Raises
    ------
    BadInput
        If its index cannot be read, or the folder cannot be read without harm.
    """
    with limited_memory():
        check_entries(folder)
        return _Published(folder).audit()


class _Published:
    def __init__(self, folder: Path):
        self.folder = folder
        index = _mapping(read_json(folder / INDEX))
        self.name = str(index.get("name"))
        self.listed = _mapping(index.get("files"))
        missing = index.get("missing")
        self.missing = [str(name) for name in missing] if isinstance(missing, list) else []
        own = (INDEX, INDEX + SIDECAR_SUFFIX)
        paths = sorted(path for path in folder.rglob("*") if path.is_file())
        names = [path.relative_to(folder).as_posix() for path in paths]
        self.digests = {name: file_digest(folder / name) for name in names if name not in own}
        self.findings: list[Finding] = []
        self.contents: dict[str, dict[str, Any]] = {}
        self.read_elsewhere = {
            name: self.sources(name) for name in self.digests if name.endswith(_READ_ELSEWHERE)
        }

    def audit(self) -> PublishedAudit:
        self.check_files()
        self.check_scores()
        shards = self.check_dataset(_DATASET)
        lineage = self.lineage(_DATASET)
        chains = [
            self.chain(name, shards, lineage)
            for name in self.digests
            if name.startswith("models/") and name.endswith(".safetensors")
        ]
        notes = self.notes(bool(lineage))
        findings = sorted_findings(self.findings)
        return PublishedAudit(self.name, len(self.digests), findings, chains, notes)

    def find(self, kind: Kind, where: str, what: str) -> None:
        self.findings.append(Finding(kind, where, what))

    def json(self, name: str) -> dict[str, Any]:
        """Content of a published JSON file; a finding, and nothing, where it cannot be read."""
        if name in self.digests and name not in self.contents:
            try:
                self.contents[name] = _mapping(read_json(self.folder / name))
            except BadInput as problem:
                self.find(Kind.ALTERED, name, first_line(problem))
                self.contents[name] = {}
        return self.contents.get(name, {})

    def check_files(self) -> None:
        for name in sorted({*self.listed, *self.digests}):
            if name not in self.digests:
                self.find(Kind.MISSING, name, f"listed in {INDEX}")
            elif name not in self.listed:
                self.find(Kind.UNEXPLAINED, name, f"not listed in {INDEX}")
            elif self.digests[name] != self.listed[name]:
                self.find(Kind.ALTERED, name, f"not the file listed in {INDEX}")
        for name in [name for name in self.digests if name.endswith(SIDECAR_SUFFIX)]:
            of = name.removesuffix(SIDECAR_SUFFIX)
            if self.json(name).get("sha256") != self.digests.get(of):
                self.find(Kind.BROKEN, of, "not the file that its record was written for")

    def record(self, name: str) -> dict[str, Any]:
        """Provenance of a published file; empty where it has none that can be read."""
        if not name.endswith(".parquet"):
            return self.json(name + SIDECAR_SUFFIX)
        try:
            return _mapping(read_metadata(self.folder / name).get("provenance"))
        except (BadInput, ValueError) as problem:
            self.find(Kind.BROKEN, name, first_line(problem))
            return {}

    def check_scores(self) -> None:
        """Whether the scores are of the published models and dataset."""
        for name in SCORES:
            if name not in self.digests:
                continue
            record = self.record(name)
            if not record:
                self.find(Kind.BROKEN, name, "has no record of what was evaluated")
                continue
            others, unscored = compare(record, self.digests)
            if others:
                what = f"scores of another {and_more(others)} than the published"
                self.find(Kind.BROKEN, name, what)
            if unsaid := [one for one in unscored if SCORES_OF + one not in self.missing]:
                self.find(Kind.BROKEN, name, f"has no scores of {and_more(unsaid)}")

    def check_dataset(self, place: str) -> dict[str, str]:
        """Digest of each file of images, by its name, as three files agree on it."""
        digests = f"{place}/digests.json"
        noted = self.json(digests)
        shards = _mapping(noted.get("files"))
        name = f"{place}/{MANIFEST}"
        if name not in self.digests:
            return shards
        try:
            _, digest = read_manifest(self.folder / place)
            record = _mapping(read_metadata(self.folder / name).get("provenance"))
        except (BadInput, ValueError) as problem:
            self.find(Kind.BROKEN, name, first_line(problem))
            return shards
        if digest != noted.get("digest"):
            self.find(Kind.BROKEN, digests, f"is of another dataset than {name}")
        if _by_file(record) != shards:
            self.find(Kind.BROKEN, digests, f"names other files of images than {name}")
        return shards

    def lineage(self, place: str) -> dict[str, dict[str, str]]:
        """What the files of images and everything behind them were made from."""
        noted = self.json(f"{place}/lineage.json")
        return {name: _mapping(inputs) for name, inputs in noted.items()}

    def sources(self, name: str) -> dict[str, tuple[int, int]]:
        """What the published readings that calibrate a model are from: videos, simulations."""
        try:
            table = read_parquet(self.folder / name, ["source", "simulation"])
        except (BadInput, ValueError) as problem:
            self.find(Kind.BROKEN, name, first_line(problem))
            return {}
        read = defaultdict(list)
        for row in table.to_pylist():
            read[str(row["source"])].append(row["simulation"])
        return {source: (len(of), len({*of})) for source, of in read.items()}

    def further(self) -> dict[str, str]:
        """Where datasets that calibrate besides are published -> digest of their manifest."""
        return {
            name.removesuffix(f"/{MANIFEST}"): digest
            for name, digest in self.digests.items()
            if name.startswith(FURTHER) and name.endswith(f"/{MANIFEST}")
        }

    def chain(
        self, weights: str, shards: dict[str, str], lineage: dict[str, dict[str, str]]
    ) -> Chain:
        """Follow a model to its images and, where their records are published, behind them."""
        card = self.json(weights.replace(".safetensors", ".json"))
        if card.get("weights_sha256") != self.digests[weights]:
            self.find(Kind.BROKEN, weights, "not the weights that their card describes")
        inputs = _mapping(self.json(weights + SIDECAR_SUFFIX).get("inputs"))
        if not inputs:
            self.find(Kind.BROKEN, weights, "has no record of what it was trained on")
        trained_on: dict[str, str] = {}
        others = []
        besides = {
            place: digest for place, digest in self.further().items() if digest in inputs.values()
        }
        for path, digest in sorted(inputs.items()):
            name = Path(path).name
            if _AVERAGED in path:  # one of the instruments of which this one is the average
                split, _, member = path.rpartition(_AVERAGED)[2].partition("/")
                of_member = f"models/{split}/instrument/{member}"
                known = self.digests.get(of_member)
                behind = _mapping(self.json(of_member + SIDECAR_SUFFIX).get("inputs"))
                trained_on |= {
                    Path(one).name: sha256
                    for one, sha256 in behind.items()
                    if Path(one).name != MANIFEST
                }
            elif _TRAINED in path:  # the network that tells this one the fabric
                known = self.digests.get(f"models/{path.rpartition(_TRAINED)[2]}")
            elif path.startswith(_READINGS) or (name == MANIFEST and digest in besides.values()):
                known = digest
            elif name == MANIFEST:
                known = self.digests.get(f"{_DATASET}/{name}")
            else:
                known, trained_on[name] = shards.get(name), digest
            if digest != known:
                others.append(name)
        if others:
            what = f"trained on another {and_more(others)} than the published"
            self.find(Kind.BROKEN, weights, what)
        if card.get("dataset_digest") != self.json(_DIGESTS).get("digest"):
            self.find(Kind.BROKEN, weights, "trained on another dataset than the published one")
        behind = self.behind(set(trained_on), lineage, _LINEAGE) if lineage else {}
        noted = card.get("calibration_readings", [])
        calibrated_on = {
            str(one.get("digest")): (one.get("videos"), one.get("simulations"))
            for one in map(_mapping, noted if isinstance(noted, list) else [{}])
        }
        files = {str(digest) for path, digest in inputs.items() if path.startswith(_READINGS)}
        datasets = {self.json(f"{place}/digests.json").get("digest") for place in besides}
        if set(calibrated_on) != files | datasets:
            self.find(Kind.BROKEN, weights, "calibrated on other readings than its record names")
        read = weights.rpartition("/")[0] + _READ_ELSEWHERE
        if calibrated_on != self.read_elsewhere.get(read, {}):
            self.find(Kind.BROKEN, weights, "calibrated on other readings than the published ones")
        for place in sorted(besides):
            shards = self.check_dataset(place)
            trained_on |= {f"{place}/{name}": digest for name, digest in shards.items()}
            if lineage := self.lineage(place):
                found = self.behind(set(shards), lineage, f"{place}/lineage.json")
                behind |= {f"{place}/{name}": digest for name, digest in found.items()}
        return Chain(
            weights,
            self.digests[weights],
            self.digests[weights] == file_digest(SHIPPED / "instrument.safetensors"),
            trained_on,
            behind,
        )

    def behind(
        self, shards: set[str], lineage: dict[str, dict[str, str]], where: str
    ) -> dict[str, str]:
        waiting = [name for name in lineage if "/sample/" in name and Path(name).name in shards]
        if missing := shards - {Path(name).name for name in waiting}:
            self.find(Kind.BROKEN, where, f"does not say what {min(missing)} was made from")
        for name in waiting:
            renders = [_mapping(lineage.get(render)) for render in lineage[name]]
            if not renders or not all(any(_SIMULATED in one for one in each) for each in renders):
                self.find(Kind.BROKEN, where, f"does not lead from {name} to its simulation")
        found: dict[str, str] = {}
        while waiting:
            for name, digest in lineage.get(waiting.pop(), {}).items():
                if name not in found:
                    waiting.append(name)
                if found.setdefault(name, digest) != digest:
                    self.find(Kind.BROKEN, where, f"has two digests of {name}")
        return found

    def notes(self, followed: bool) -> list[str]:
        notes = self.lacking()
        notes += self.origin()
        notes.append(
            "only the digests of images, renders and simulations are published: they were compared "
            "with each other, not with files"
        )
        datasets = {self.json(f"{place}/digests.json").get("digest") for place in self.further()}
        notes += [
            f"{name}: what stretches the intervals was read of videos that are not published"
            for name, sources in self.read_elsewhere.items()
            if sources.keys() - datasets
        ]
        if not followed:
            notes.append(
                f"{_LINEAGE} is not published, so that the digests of the simulations are not: the "
                "chain ends at the files of images"
            )
        return notes

    def lacking(self) -> list[str]:
        """What of the run is not published, as the index says."""
        files = [name for name in self.missing if not name.startswith(SCORES_OF)]
        scores = [name for name in self.missing if name.startswith(SCORES_OF)]
        notes = []
        if files:
            notes.append(f"partial: {len(files)} files of the run are missing: {and_more(files)}")
        if scores:
            notes.append(f"partial: missing are {and_more(scores)}")
        return notes

    def origin(self) -> list[str]:
        """The commits that the stages ran with, and those whose code is another by now."""
        commits: dict[str, set[str]] = defaultdict(set)
        dirty, others = set(), set()
        for record in self.records():
            stage, commit = record.get("stage"), record.get("git_commit")
            if not (isinstance(stage, str) and all(map(str.isidentifier, stage.split(".")))):
                continue
            commits[commit[:12] if isinstance(commit, str) else "unknown"].add(stage)
            if record.get("git_dirty"):
                dirty.add(stage)
            if "code_digest" in record and any(other_code(Artefact("", "", provenance=record))):
                others.add(stage)
        notes = []
        if commits:
            of_each = (f"{name} ({_list(stages)})" for name, stages in sorted(commits.items()))
            notes.append(f"made by the code of commit {', '.join(of_each)}")
        if dirty:
            notes.append(f"made with uncommitted changes: {_list(dirty)}")
        if others:
            notes.append(f"made by other code or libraries than those that audit: {_list(others)}")
        return notes

    def records(self) -> list[dict[str, Any]]:
        """Every record in the folder, and those of the stages whose files are not published."""
        own = self.folder / (INDEX + SIDECAR_SUFFIX)
        return [
            *(self.json(name) for name in self.digests if name.endswith(SIDECAR_SUFFIX)),
            *(self.record(name) for name in self.digests if name.endswith(".parquet")),
            *map(_mapping, self.json("origin.json").values()),
            _mapping(read_json(own)) if own.is_file() else {},
        ]


def _mapping(value: Any) -> dict[str, Any]:
    return dict(value) if isinstance(value, Mapping) else {}


def _list(stages: set[str]) -> str:
    return ", ".join(sorted(stages))


def _by_file(record: Mapping[str, Any]) -> dict[str, str]:
    """The inputs of a record by their file names."""
    return {Path(name).name: digest for name, digest in _mapping(record.get("inputs")).items()}
