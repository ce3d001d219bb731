"""Material network, friction network, friction network conditioned on the predicted material."""

from slipstitch.config.train import NETWORKS
from slipstitch.design.trainable import (
    check_networks_can_train,
    keeps_networks_of_all_views,
    trainings,
)


def material_network(wildcards):
    """The material network that the conditional one of the same split and seed listens to."""
    if wildcards.network != "friction_conditional":
        return []
    return (
        f"results/train/{wildcards.split}/material_baseline/seed{wildcards.seed}/model.safetensors"
    )


def material_option(wildcards, input):
    """The option that hands over the folder of that network."""
    return f"--material-model {Path(input.material).parent}" if input.material else ""


rule train:
    input:
        expand(
            "results/train/{training}/{file}",
            training=[
                f"{split}/{network}/seed{seed}"
                for split in CONFIG.train.splits
                for network, seed in trainings(CONFIG.train, split)
            ],
            file=["model.safetensors", "model.json", "history.csv"],
        ),


rule train_one:
    input:
        dataset=unless_refused(check_networks_can_train, rules.sample.input),
        material=material_network,
    output:
        expand(
            "results/train/{{split}}/{{network}}/seed{{seed}}/all_views/{file}",
            file=(
                ["model.safetensors", "model.json"]
                if keeps_networks_of_all_views(CONFIG.train)
                else []
            ),
        ),
        model="results/train/{split}/{network}/seed{seed}/model.safetensors",
        card="results/train/{split}/{network}/seed{seed}/model.json",
        history=report(
            "results/train/{split}/{network}/seed{seed}/history.csv",
            caption="../workflow/report/training.rst",
            category="Training",
            labels={"split": "{split}", "network": "{network}", "seed": "{seed}"},
        ),
    log:
        "results/logs/train/{split}_{network}_seed{seed}.log",
    benchmark:
        "results/benchmarks/train/{split}_{network}_seed{seed}.tsv"
    wildcard_constraints:
        network="|".join(NETWORKS),
    priority: 1
    threads: 1
    resources:
        mem_mb=job_memory_mb("train", CONFIG),
        runtime=job_runtime_min("train", CONFIG),
    params:
        *settings(
            "seed",
            "train",
            train={"seeds", "splits"},
        ),
        views=VIEW_ORDER,
        code=code_of("train"),
        config=CONFIG_FILE,
        folder=subpath(output.model, parent=True),
        material=material_option,
    message:
        "Train {wildcards.network}, split {wildcards.split}, seed {wildcards.seed}"
    shell:
        "slipstitch train --config {params.config} --dataset results/sample"
        " --network {wildcards.network} --split {wildcards.split} --seed {wildcards.seed}"
        " {params.material} --threads {threads} --out-dir {params.folder} > {log} 2>&1"
