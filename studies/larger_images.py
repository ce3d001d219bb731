"""Whether larger images tell the fabrics that are pushed: a network trained on at other sizes.

    python studies/larger_images.py CONFIG DATASET NETWORK --pixels 32 48 64 --out-dir DIR

NETWORK is a folder with a fabric network of all views, such as ``all_views`` of the paper's. Its
last map is averaged over the image, so that its weights fit images of any size: they are trained on
in all views, first at the full rate, then down a cosine. Written to DIR/larger_images.json: how
often the fabric of the test videos is right, over all and by coefficient, and the CPU time. A size
that DIR has is not trained again. A study: asked once, not maintained.
"""

import argparse
from pathlib import Path
from unittest.mock import patch

import numpy as np

from slipstitch.base.provenance import provenance_record, read_provenance, start_clock, write_json
from slipstitch.config import load_config
from slipstitch.dataset.manifest import MANIFEST, read_manifest
from slipstitch.dataset.videos import read_videos
from slipstitch.design.trainable import view_order
from slipstitch.learning.evaluation.test_sets import evaluation_sets
from slipstitch.learning.lrcn import CARD, LRCN, WEIGHTS, load_model
from slipstitch.learning.lrcn_training import train_network
from slipstitch.learning.trainer import Phase, Run

PHASES = {"full rate": 4, "falling rate": 6}  # epochs


def right_by_friction(folder, dataset):
    """Return of the test videos the share whose fabric is right, over all and by coefficient."""
    model = load_model(folder)
    tests = {test.name: test for test in evaluation_sets(read_manifest(dataset)[0])}
    of_split = tests[model.card["split"]].holds
    videos = read_videos(dataset, of_split, model.card["pixels"], model.card["frames"])
    names = [one["name"] for one in model.card["classes"]]
    told = model.probabilities(videos).argmax(1)
    right = np.take(names, told) == np.array([row["material"] for row in videos.rows])
    friction = np.array([row["friction"] for row in videos.rows])
    by_friction = {f"{mu:g}": float(right[friction == mu].mean()) for mu in np.unique(friction)}
    return {"videos": len(right), "right": float(right.mean()), "by_friction": by_friction}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("config", type=Path)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("network", type=Path)
    parser.add_argument("--pixels", type=int, nargs="+", required=True)
    parser.add_argument("--out-dir", type=Path, required=True)
    chosen = parser.parse_args()
    started = start_clock()
    config = load_config(chosen.config)
    views = tuple(view_order(config))
    begun = load_model(chosen.network)
    card, weights = begun.card, begun.network.state_dict()
    phases = [Phase(name, views, epochs) for name, epochs in PHASES.items()]
    result = {"pixels": card["pixels"], "before": right_by_friction(chosen.network, chosen.dataset)}
    result |= {"epochs": PHASES, "trained_on": {}}
    read = [chosen.dataset / MANIFEST]
    read += [chosen.network / name for name in (WEIGHTS, CARD)]
    for pixels in chosen.pixels:
        folder = chosen.out_dir / str(pixels)
        if not (folder / WEIGHTS).is_file():
            settings = config.train.model_copy(update={"pixels": pixels})
            run = Run(chosen.dataset, card["split"], card["seed"], folder, card["frames"])
            with patch.object(LRCN, "initialise", lambda self: self.load_state_dict(weights)):
                train_network(settings, run, "material_baseline", views, phases=phases)
        files = [folder / name for name in (WEIGHTS, CARD)]
        cpu_s = read_provenance(files[0])["cpu_s"]
        scores = right_by_friction(folder, chosen.dataset)
        result["trained_on"][pixels] = scores | {"cpu_s": cpu_s}
        read += files
        record = provenance_record("train", inputs=read, started=started)
        write_json(chosen.out_dir / "larger_images.json", result, record)
        print(pixels, result["trained_on"][pixels], flush=True)


if __name__ == "__main__":
    main()
