"""The audit of a published folder: its files, and its models back to their simulations."""

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from slipstitch.base.errors import BadInput, Damaged, first_line
from slipstitch.base.provenance import file_digest, read_json, read_metadata
from slipstitch.base.provenance.files import SIDECAR_SUFFIX
from slipstitch.dataset.audit.admission import check_entries, limited_memory
from slipstitch.dataset.audit.findings import Finding, Kind, not_part, printable, sorted_findings
from slipstitch.dataset.audit.lineage_check import other_code
from slipstitch.dataset.manifest import MANIFEST, read_manifest
from slipstitch.dataset.release.records import Artefact

#: Of a folder that `slipstitch publish` wrote.
INDEX = "published.json"
WEIGHTS = ".safetensors"
#: Where datasets of other benches, which calibrate an average, are published.
FURTHER = "calibration_datasets/"
_DATASET = "dataset"
_DIGESTS, _LINEAGE = f"{_DATASET}/digests.json", f"{_DATASET}/lineage.json"
_SIMULATED, _SAMPLED = "/simulate/", "sample/"
_READ_ELSEWHERE = "/readings.parquet"
#: Scores, and the predictions that they are computed from.
_SCORES, _PREDICTIONS = "metrics.json", "predictions.parquet"
_NOTES = (
    "only the digests of images, renders and simulations are published: they were compared with "
    "each other, not with files",
    "nothing here is signed: the audit finds accidents, not whoever made all files agree",
)


@dataclass(frozen=True)
class Chain:
    """What a published model comes from, as far as its records tell."""

    weights: str  # file of its weights, published or not
    sha256: str  # of the weights
    published: bool  # whether the weights themselves are there
    shipped: bool  # whether these are the weights that come with Slipstitch
    shards: dict[str, str]  # files of images that it was trained and calibrated on -> SHA-256
    behind: dict[str, str]  # everything that these were made from -> SHA-256

    @property
    def simulations(self) -> dict[str, str]:
        """The simulations among it."""
        return {name: digest for name, digest in self.behind.items() if _SIMULATED in name}


class PublishedAudit:
    """The outcome: its findings, the chains of its models, notes on what is no damage."""

    def __init__(self, folder: Path, shipped: str, recompute: Callable | None):
        self.folder = folder
        index = _mapping(read_json(folder / INDEX))
        self.name = str(index.get("name"))
        self.listed = _mapping(index.get("files"))
        missing = index.get("missing")
        self.missing = missing if isinstance(missing, list) else []
        paths = sorted(path for path in folder.rglob("*") if path.is_file())
        names = {path.relative_to(folder).as_posix() for path in paths}
        self.others = sorted(names - set(self.listed) - {INDEX, INDEX + SIDECAR_SUFFIX})
        there = sorted(names & set(self.listed))
        self.digests = {name: file_digest(folder / name) for name in there}
        self.findings: list[Finding] = []
        self.contents: dict[str, dict[str, Any]] = {}
        self.check_files()
        self.check_models()
        self.check_datasets()
        for name in self.records:
            self.check_inputs(name)
        self.chains = [self.chain(weights, shipped) for weights in self.models]
        self.notes = self.remarks()
        if recompute is not None and {_SCORES, _PREDICTIONS} <= set(self.digests):
            self.notes += self.check_scores(recompute)
        self.findings = sorted_findings(self.findings)

    @property
    def verdict(self) -> str:
        """``intact`` without findings, else ``damaged``."""
        return "damaged" if self.findings else "intact"

    def as_json(self) -> dict[str, Any]:
        """The outcome as JSON can hold it."""
        return {
            "published": self.name,
            "verdict": self.verdict,
            "files": len(self.digests),
            "findings": [asdict(finding) for finding in self.findings],
            "models": [asdict(chain) | {"simulations": chain.simulations} for chain in self.chains],
            "notes": self.notes,
        }

    def as_text(self) -> str:
        """The outcome as lines."""
        lines = [f"{self.name}: {self.verdict}, {len(self.digests)} files checked"]
        lines += [f"  {one.kind.value}: {one.where}: {one.what}" for one in self.findings]
        for chain in self.chains:
            where = "" if chain.published else ", weights not published"
            where = ", the instrument that ships" if chain.shipped else where
            reached = "simulations whose digests are not published"
            if chain.simulations:
                reached = f"the digests of {len(chain.simulations)} simulations"
            lines.append(f"{chain.weights}: {chain.sha256}{where}")
            lines.append(f"  from {len(chain.shards)} files of images, from {reached}")
        return "\n".join(map(printable, [*lines, *(f"note: {note}" for note in self.notes)]))

    def chain(self, weights: str, shipped: str) -> Chain:
        digest, shards = self.models[weights], self.shards(weights)
        published, ships = weights in self.digests, digest == shipped
        return Chain(weights, digest, published, ships, shards, self.behind(shards))

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

    @cached_property
    def records(self) -> dict[str, dict[str, Any]]:
        """Published file, or one whose record alone is published -> its provenance."""
        found = {}
        for name in self.digests:
            if name.endswith(SIDECAR_SUFFIX):
                found[name.removesuffix(SIDECAR_SUFFIX)] = self.json(name)
            elif name.endswith(".parquet"):
                try:
                    found[name] = _mapping(read_metadata(self.folder / name).get("provenance"))
                except (BadInput, ValueError) as problem:
                    self.find(Kind.BROKEN, name, first_line(problem))
        return found

    @cached_property
    def models(self) -> dict[str, str]:
        """Weights of every model -> SHA-256 that its card names."""
        return {
            name.replace(".json", WEIGHTS): str(self.json(name).get("weights_sha256"))
            for name in self.digests
            if name.endswith(("/model.json", "/instrument.json"))
        }

    @cached_property
    def known(self) -> dict[str, str]:
        """File as records call it, without the folder of the results -> SHA-256 published of it."""
        files = _mapping(self.json(_DIGESTS).get("files"))
        known = {f"{_SAMPLED}{name}": digest for name, digest in files.items()}
        known[_SAMPLED + MANIFEST] = self.digests.get(f"{_DATASET}/{MANIFEST}", "")
        for name, digest in (self.digests | self.models).items():
            if name.startswith("models/"):
                folder = name.removeprefix("models/")
                split, _, rest = folder.partition("/instrument/")
                known[f"instrument/{split}/{rest}" if rest else f"train/{folder}"] = digest
        return known

    def check_files(self) -> None:
        for name, digest in self.listed.items():
            if name not in self.digests:
                self.find(Kind.MISSING, name, f"listed in {INDEX}")
            elif self.digests[name] != digest:
                self.find(Kind.ALTERED, name, f"not the file listed in {INDEX}")
        for name, record in self.records.items():
            if (own := self.digests.get(name)) and record.get("sha256", own) != own:
                self.find(Kind.BROKEN, name, "not the file that its record was written for")

    def check_models(self) -> None:
        for name, digest in self.models.items():
            record = self.records.get(name, {})
            if not record.get("inputs"):
                self.find(Kind.BROKEN, name, "has no record of what it was trained on")
            if not self.digests.get(name, digest) == record.get("sha256", digest) == digest:
                self.find(Kind.BROKEN, name, "not the weights that their card describes")

    @cached_property
    def datasets(self) -> dict[str, str]:
        """Folder of every published dataset -> SHA-256 of its manifest."""
        end = f"/{MANIFEST}"
        return {n.removesuffix(end): one for n, one in self.digests.items() if n.endswith(end)}

    def check_datasets(self) -> None:
        """Whether every published manifest is the one of the published digests."""
        for place in self.datasets:
            try:
                _, digest = read_manifest(self.folder / place)
            except BadInput as problem:
                self.find(Kind.BROKEN, f"{place}/{MANIFEST}", first_line(problem))
                continue
            if digest != self.json(f"{place}/digests.json").get("digest"):
                what = f"is of another dataset than {place}/{MANIFEST}"
                self.find(Kind.BROKEN, f"{place}/digests.json", what)

    def check_scores(self, recompute: Callable[[Path], Mapping[str, Any]]) -> list[str]:
        """Compare every score with what the predictions give; return what was not compared."""
        try:
            expected = _leaves(recompute(self.folder / _PREDICTIONS))
        except Damaged as problem:
            self.find(Kind.ALTERED, _PREDICTIONS, first_line(problem))
            return []
        except BadInput as problem:
            return [f"scores not compared with the predictions: {first_line(problem)}"]
        stated = _leaves(self.json(_SCORES))
        odd = [key for key in expected | stated if stated.get(key) != expected.get(key)]
        if odd:
            first, more = odd[0], f" ({len(odd)} scores differ)" if len(odd) > 1 else ""
            what = f"{' '.join(first)} is {stated.get(first)}, its predictions give "
            self.find(Kind.BROKEN, _SCORES, f"{what}{expected.get(first)}{more}")
        return []

    def check_inputs(self, name: str) -> None:
        """Whether a file was made from those that are published.

        The digest of a dataset is of its decoded images: a network may have been trained where the
        same ones were filmed again, into other files.
        """
        inputs = _mapping(self.records[name].get("inputs"))
        folder = name.rpartition("/")[0]
        card = self.json(f"{folder}/model.json") or self.json(f"{folder}/instrument.json")
        same = card.get("dataset_digest", "") == self.json(_DIGESTS).get("digest")
        again = same and self.datasets.get(_DATASET) not in inputs.values()
        for path, digest in inputs.items() if not name.startswith(FURTHER) else ():
            place = path.partition("/")[2]
            if again and place.startswith(_SAMPLED):
                continue
            if self.known.get(place, digest) != digest:
                what = f"made from another {Path(path).name} than the published"
                self.find(Kind.BROKEN, name, what)
                return

    def inputs(self, weights: str) -> dict[str, str]:
        """What a model, or the models that it averages, were made from."""
        inputs = dict(_mapping(self.records.get(weights, {}).get("inputs")))
        for path in list(inputs):
            split, _, member = path.partition("/instrument/")[2].partition("/")
            inputs |= self.inputs(f"models/{split}/instrument/{member}") if member else {}
        return inputs

    def shards(self, weights: str) -> dict[str, str]:
        """Files of images that a model, or the models that it averages, were trained on."""
        inputs = self.inputs(weights)
        sampled = [path for path in inputs if path.partition("/")[2].startswith(_SAMPLED)]
        found = {Path(path).name: inputs[path] for path in sampled}
        found.pop(MANIFEST, None)
        for place, manifest in self.datasets.items():
            if place.startswith(FURTHER) and manifest in inputs.values():
                files = _mapping(self.json(f"{place}/digests.json").get("files"))
                found |= {f"{place}/{name}": digest for name, digest in files.items()}
        return found

    def behind(self, shards: Iterable[str]) -> dict[str, str]:
        """Everything that some files of images were made from, by the published lineage."""
        found: dict[str, str] = {}
        for shard in shards:
            place, _, name = shard.rpartition("/")
            where = f"{place or _DATASET}/lineage.json"
            lineage = self.json(where)
            waiting = [path for path in lineage if path.endswith(f"/sample/{name}")]
            if lineage and not waiting:
                self.find(Kind.BROKEN, where, f"does not say what {name} was made from")
            while waiting:
                for path, digest in _mapping(lineage.get(waiting.pop())).items():
                    full = f"{place}/{path}" if place else path
                    if full not in found:
                        waiting.append(path)
                    found[full] = digest
        return found

    def remarks(self) -> list[str]:
        notes = [not_part("what was published", self.others)] if self.others else []
        if count := len(self.missing):
            more = f" and {count - 1} more" if count > 1 else ""
            notes.append(f"partial: {count} parts of the run are missing: {self.missing[0]}{more}")
        notes += [*self.origin(), *_NOTES]
        if any(name.endswith(_READ_ELSEWHERE) for name in self.digests):
            notes.append("what stretches the intervals was read of videos that are not published")
        if not self.json(_LINEAGE):
            missing = f"{_LINEAGE} is not published, so that the digests of the simulations are not"
            notes.append(f"{missing}: the chain ends at the files of images")
        return notes

    def origin(self) -> list[str]:
        """The commits that the stages ran with, and those whose code is another by now."""
        own = self.folder / (INDEX + SIDECAR_SUFFIX)
        records = [*self.records.values(), *map(_mapping, self.json("origin.json").values())]
        records.append(_mapping(read_json(own)) if own.is_file() else {})
        commits: dict[str, set[str]] = defaultdict(set)
        dirty, others = set(), set()
        for record in records:
            stage, commit = record.get("stage"), record.get("git_commit")
            if not (isinstance(stage, str) and all(map(str.isidentifier, stage.split(".")))):
                continue
            commits[commit[:12] if isinstance(commit, str) else "unknown"].add(stage)
            if record.get("git_dirty"):
                dirty.add(stage)
            if "code_digest" in record and any(other_code(Artefact("", "", provenance=record))):
                others.add(stage)
        of_each = [f"{name} ({_list(stages)})" for name, stages in sorted(commits.items())]
        told = {
            "made by the code of commit ": ", ".join(of_each),
            "made with uncommitted changes: ": _list(dirty),
            "made by other code or libraries than those that audit: ": _list(others),
        }
        return [words + names for words, names in told.items() if names]


def audit_published(
    folder: Path, shipped: str = "", recompute: Callable[[Path], Mapping[str, Any]] | None = None
) -> PublishedAudit:
    """Audit a folder that `slipstitch publish` wrote; BadInput if it cannot be read without harm.

    `shipped` is the SHA-256 of the shipped weights; `recompute` gives of predictions their scores.
    """
    with limited_memory():
        check_entries(folder)
        return PublishedAudit(folder, shipped, recompute)


def _leaves(content: Any, place: tuple[str, ...] = ()) -> dict[tuple[str, ...], Any]:
    """Every value of nested mappings by the keys that lead to it."""
    if not isinstance(content, Mapping):
        return {place: content}
    parts = (_leaves(value, (*place, str(key))) for key, value in content.items())
    return {place: value for part in parts for place, value in part.items()}


def _mapping(value: Any) -> dict[str, Any]:
    return dict(value) if isinstance(value, Mapping) else {}


def _list(stages: set[str]) -> str:
    return ", ".join(sorted(stages))
