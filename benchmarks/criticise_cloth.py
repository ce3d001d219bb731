"""Effects hidden in the cloth simulator at another mesh and step than the ones that judge.

``python benchmarks/criticise_cloth.py --rows 321 --step 0.02`` (about five minutes an effect): a
campaign of drop-and-drag at that mesh (vertices along the cloth; the judging simulations have 161)
and largest step (s; they have 0.04), criticised, its runs simulated again with models found without
their specimen. One line an effect. The bench's cloth has one bending stiffness at every curvature:
where a step takes it makes no difference here.
"""

import argparse
import os
import sys
import tempfile
from pathlib import Path

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from support.hidden_effects.cloth_bench import make_campaign

from slipstitch.criticise.case import read_case
from slipstitch.criticise.inference.analysis import analyse
from slipstitch.criticise.measurements import assemble
from slipstitch.criticise.resimulation import resimulate_left_out
from slipstitch.criticise.verdict import sentence, verdict_of

EFFECTS = {
    "nothing": {},
    "anisotropy": {"anisotropy": {"anisotropy": 0.25}},
    "nap": {"nap": {"nap": 0.2}},
    "bending_error": {"bending_error": {"bending_error": 1.0}},
}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=int, default=321)
    parser.add_argument("--step", type=float, default=0.02)
    parser.add_argument("--effects", nargs="+", choices=EFFECTS, default=list(EFFECTS))
    parser.add_argument("--repeats", type=int, default=4, help="runs of each of six specimens")
    arguments = parser.parse_args()
    for name in arguments.effects:
        with tempfile.TemporaryDirectory() as folder:
            make_campaign(
                folder,
                EFFECTS[name],
                repeats=arguments.repeats,
                rows=arguments.rows,
                step_s=arguments.step,
            )
            case = read_case(folder)
        verdict = verdict_of(case, analyse(assemble(case)), 1, "benchmark")
        again = resimulate_left_out(case, 1, 300).summary["all"]
        print(
            f"{name}: {sentence(verdict)} Shapes left out: {again['rmse_null_mm']:.2f} -> "
            f"{again['rmse_extended_mm']:.2f} mm, gain {again['gain']:.2f} {again['gain_ci95']}",
            flush=True,
        )


if __name__ == "__main__":
    main()
