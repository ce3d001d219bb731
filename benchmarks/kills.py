"""kill -9 at random moments in every stage of the smoke chain: are the results identical?

Every kill starts from an undisturbed run, removes what one job made, has it made again, kills the
machine's processes, the working process or Snakemake alone at a random moment, gives the same
command again, and compares every artefact's content with the undisturbed run.
"""

import argparse
import json
import random
import sys
import tempfile
import time
from collections import Counter
from dataclasses import asdict
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from support import equal_results, kills
from support.workflow_copy import Workflow


def undisturbed(
    folder: Path, targets: list[str]
) -> tuple[Workflow, Path, dict[str, str], list[dict]]:
    """A run of the whole chain and further targets: workflow, folder, digests, jobs."""
    workflow = Workflow(folder, scale="config/smoke.yaml")  # what a folder holds is used
    answer = workflow.snakemake("all", *targets)
    if answer.returncode != 0:
        sys.exit(answer.stdout + answer.stderr)
    pristine = folder / "pristine"
    kills.copy_run(workflow.folder, pristine)
    results = pristine / "results"
    return workflow, pristine, equal_results.digests(results), kills.jobs(pristine)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--minutes", type=float, default=1e9, help="begin no kill after this time")
    parser.add_argument("--folder", type=Path, help="where to work; a temporary folder by default")
    parser.add_argument("--out", type=Path, help="JSON lines, one a kill")
    parser.add_argument("--targets", nargs="*", default=[], help="besides all")
    arguments = parser.parse_args()
    chance = random.Random(arguments.seed)
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.folder or Path(temporary)
        workflow, pristine, reference, jobs = undisturbed(folder, arguments.targets)
        print(f"undisturbed: {time.monotonic() - began:.0f} s, {len(reference)} artefacts")
        rules = sorted({job["rule"] for job in jobs})
        done = []
        while len(done) < arguments.kills and time.monotonic() - began < 60 * arguments.minutes:
            rule = rules[len(done) % len(rules)]  # every stage as often as any other
            job = chance.choice([one for one in jobs if one["rule"] == rule])
            victim = chance.choice(kills.VICTIMS)
            one = kills.kill_and_resume(
                workflow,
                pristine,
                reference,
                job,
                victim,
                chance,
                by_command=len(done) < len(rules),
            )
            done.append(one)
            if arguments.out:
                with open(arguments.out, "a", encoding="utf-8") as stream:
                    stream.write(json.dumps(asdict(one)) + "\n")
            print(
                f"{len(done):>4} {one.rule:<20} {one.victim:<9} {one.after_s:>6.2f} s "
                f"{'hit' if one.hit else 'over'} {'unlocked' if one.locked else ''} "
                f"{'; '.join(one.problems) or 'same'}",
                flush=True,
            )
    same = sum(not one.problems for one in done)
    print(
        f"{len(done)} kills, {sum(one.hit for one in done)} of something that ran: {same} the same"
    )
    print("by rule:", dict(Counter(one.rule for one in done)))
    return 0 if same == len(done) else 1


if __name__ == "__main__":
    sys.exit(main())
