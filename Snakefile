"""Slipstitch, the whole chain: snakemake --cores 2 all (docs/run-the-factory.md)."""

from pathlib import Path

from snakemake.utils import min_version

min_version("9.0")


report: "workflow/report/workflow.rst"


# Scales: --configfile config/smoke.yaml and config/paper.yaml merge over this one.
configfile: Path(workflow.basedir) / "config.yaml"


include: "rules/common.smk"
include: "rules/calibrate.smk"
include: "rules/simulate.smk"
include: "rules/convergence.smk"
include: "rules/render.smk"
include: "rules/sample.smk"
include: "rules/train.smk"
include: "rules/instrument.smk"
include: "rules/evaluate.smk"
include: "rules/ablate.smk"
include: "rules/criticise.smk"
include: "rules/release.smk"
include: "rules/audit.smk"
include: "rules/report.smk"
include: "rules/publish.smk"
include: "rules/captures.smk"
include: "rules/status.smk"


localrules:
    all,
    grid,
    calibrate,
    simulate,
    convergence,
    render,
    sample,
    train,
    instrument,
    evaluate,
    ablate,
    criticise,
    release,
    audit,
    report,
    publish,
    captures,


# Before a run and in a dry run, but not again in the processes of its jobs.
if workflow.is_main_process:
    print(estimate_line(CONFIG), file=sys.stderr)


# Every stage's files are requested by name: a deleted simulation is regenerated even if
# everything made from it still exists.
rule all:
    default_target: True
    input:
        rules.calibrate.input,
        rules.simulate.input,
        rules.render.input,
        rules.sample.input,
        rules.train.input,
        rules.instrument.input,
        rules.evaluate.input,
        rules.criticise.input,
        rules.release.input,
        rules.audit.input,
        rules.report.input,
