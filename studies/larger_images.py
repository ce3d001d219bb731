r"""Whether larger images tell fabrics that are pushed: a network trained on at another size.

    python studies/larger_images.py CONFIG DATASET NETWORK --pixels 64 --out-dir larger \
        --out larger.json

NETWORK is a folder with a fabric network of all views, such as all_views of the paper's. Pooling
over the whole last map lets its weights see images of any size: they are trained on in all views,
first at the full rate, then down a cosine. The network's own size, trained on as long, is what to
compare with. Printed and written: how often the fabric is right on the test videos, by coefficient,
before and after. A study: asked once, not maintained.
"""

import argparse
from pathlib import Path
from unittest.mock import patch

import numpy as np

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import provenance_record, start_clock, write_json
from slipstitch.config import load_config
from slipstitch.dataset.manifest import MANIFEST
from slipstitch.dataset.videos import read_videos
from slipstitch.design.trainable import view_order
from slipstitch.learning.lrcn import CARD, LRCN, WEIGHTS, load_model
from slipstitch.learning.lrcn_training import train_network
from slipstitch.learning.trainer import Phase, Run


def right_by_friction(folder, dataset, views, textures):
    """Return the share of test videos whose fabric is right, over all and by coefficient."""
    model = load_model(folder)

    def tests(row):
        known = row["viewpoint"] in views and row["texture"] in textures
        return row[f"split_{model.card['split']}"] == "test" and known

    videos = read_videos(dataset, tests, model.card["pixels"], model.card["frames"])
    names = [one["name"] for one in model.card["classes"]]
    told = model.probabilities(videos).argmax(1)
    right = np.take(names, told) == np.array([row["material"] for row in videos.rows])
    friction = np.array([row["friction"] for row in videos.rows])
    shares = {f"{mu:g}": float(right[friction == mu].mean()) for mu in np.unique(friction)}
    return {"videos": len(right), "right": float(right.mean()), "by_friction": shares}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("config", type=Path)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("network", type=Path)
    parser.add_argument("--pixels", type=int, required=True)
    parser.add_argument("--epochs", type=int, nargs=2, default=(4, 6), help="at full rate, falling")
    parser.add_argument("--out-dir", type=Path, required=True, help="of the trained network")
    parser.add_argument("--out", type=Path, required=True, help="JSON file")
    chosen = parser.parse_args()
    if chosen.out_dir.exists():  # a checkpoint does not know NETWORK
        raise BadInput(f"{chosen.out_dir}: exists; choose another folder")
    started = start_clock()
    config = load_config(chosen.config)
    views = tuple(view_order(config))
    before = load_model(chosen.network)
    card, weights = before.card, before.network.state_dict()
    phases = [
        Phase(name, views, epochs)
        for name, epochs in zip(("full rate", "falling rate"), chosen.epochs, strict=True)
    ]
    with patch.object(LRCN, "initialise", lambda network: network.load_state_dict(weights)):
        train_network(
            config.train.model_copy(update={"pixels": chosen.pixels}),
            Run(chosen.dataset, card["split"], card["seed"], chosen.out_dir, card["frames"]),
            "material_baseline",
            views,
            phases=phases,
        )
    seen = chosen.dataset, views, config.render.textures
    folders = {"before": chosen.network, "after": chosen.out_dir}
    result = {name: right_by_friction(folder, *seen) for name, folder in folders.items()}
    result |= {"pixels": [card["pixels"], chosen.pixels], "epochs": list(chosen.epochs)}
    print(result)
    read = [folder / name for folder in folders.values() for name in (WEIGHTS, CARD)]
    read.append(chosen.dataset / MANIFEST)
    write_json(chosen.out, result, provenance_record("train", inputs=read, started=started))


if __name__ == "__main__":
    main()
