"""The release, checked to the last pixel."""


rule audit:
    input:
        "results/audit/audit.json",
        "results/audit/index.html",


rule audit_release:
    input:
        "results/release",
    output:
        outcome="results/audit/audit.json",
        page=report(
            "results/audit/index.html",
            caption="../workflow/report/audit.rst",
            category="Release",
        ),
    log:
        "results/logs/audit/audit.log",
    benchmark:
        "results/benchmarks/audit/audit.tsv"
    threads: 1
    resources:
        mem_mb=job_memory_mb("audit"),
        runtime=job_runtime_min("audit", CONFIG),
    params:
        code=code_of("audit"),
        study=STUDY,
    message:
        "Audit the release"
    # Damage fails the run; that code has changed since is for the page to say.
    shell:
        "slipstitch audit {input} --allow-stale --jobs {threads} --json {output.outcome}"
        " --page {output.page} > {log} 2>&1"
