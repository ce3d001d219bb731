"""The lineage from a clip to its sources, and from a source to its clips."""

from collections import defaultdict
from collections.abc import Mapping
from functools import cached_property
from typing import Any

from slipstitch.dataset.audit.contents import Contents
from slipstitch.dataset.release.manifest import MANIFEST
from slipstitch.dataset.release.records import VERIFICATION, Artefact, carried_file, record_file

SAMPLED_MANIFEST = f"results/sample/{MANIFEST}"


class Lineage:
    """The records of a release and what each clip comes from."""

    def __init__(self, contents: Contents):
        self.contents = contents
        self.artefacts = contents.artefacts
        self._behind: dict[tuple[str, str | None], tuple[str, ...]] = {}

    def inputs(self, path: str, viewpoint: str | None) -> list[str]:
        """Paths of what `path` was made from, as far as a clip of `viewpoint` is concerned."""
        artefact = self.artefacts.get(path)
        wanted = []
        for name in artefact.inputs if artefact else ():
            behind = self.artefacts.get(name)
            of_view = behind.metadata.get("viewpoint") if behind else None
            other = isinstance(of_view, dict) and of_view.get("id") not in (None, viewpoint)
            if viewpoint is None or not other:
                wanted.append(name)
        return wanted

    def behind(self, row: Mapping[str, Any]) -> tuple[str, ...]:
        """Artefacts behind a clip, the nearest first; also those that have no record."""
        start = f"results/sample/{row['sampled_file']}"
        key = start, row.get("viewpoint_id")
        if key not in self._behind:
            found: dict[str, None] = {}
            waiting = [start]
            while waiting:
                path = waiting.pop(0)
                if path not in found:
                    found[path] = None
                    waiting += self.inputs(path, key[1])
            self._behind[key] = tuple(found)
        return self._behind[key]

    def of_stage(self, row: Mapping[str, Any], stage: str) -> list[Artefact]:
        """Records of one stage behind a clip."""
        records = (self.artefacts.get(path) for path in self.behind(row))
        return [record for record in records if record is not None and record.stage == stage]

    @cached_property
    def clips_after(self) -> dict[str, tuple[str, ...]]:
        """Artefact -> clips that were made from it."""
        found: dict[str, list[str]] = defaultdict(list)
        for row in self.contents.rows:
            for path in self.behind(row):
                found[path].append(row["video"])
        return {path: tuple(clips) for path, clips in found.items()}

    def clips(self, path: str) -> tuple[str, ...]:
        """Clips that were made from the artefact; manifest and verification concern all."""
        if path in (SAMPLED_MANIFEST, VERIFICATION):
            return tuple(self.contents.clips)
        return self.clips_after.get(path, ())

    @cached_property
    def _carried(self) -> dict[str, str]:
        """Path of an artefact in a release -> the artefact."""
        known = {*self.artefacts, *self.clips_after}
        records = {record_file(path): path for path in known}
        return records | {carried_file(path): path for path in known}

    def clips_of_file(self, name: str) -> tuple[str, ...]:
        """Clips that a file of the release is about: their images, or a record behind them."""
        if artefact := self._carried.get(name):
            return self.clips(artefact)
        return self._in_shard.get(name, ())

    @cached_property
    def _in_shard(self) -> dict[str, tuple[str, ...]]:
        found: dict[str, list[str]] = defaultdict(list)
        for row in self.contents.rows:
            found[row["shard"]].append(row["video"])
        return {shard: tuple(clips) for shard, clips in found.items()}
