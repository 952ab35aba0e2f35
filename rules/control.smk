# Controllers for the model with and without its gap, the closed loop that tells them apart, the adversary, the recording.


# Where the results stand of a run with other numbers of trials than a plain one: `snakemake full`, `snakemake audit_deep`.
TRIALS = {"": "plain", "full/": "full", "deep/": "deep"}


def baseline_file(name):
    """What is made of the controller that checks its model between samples, where the case wants one."""

    def path(wildcards):
        section = case_of(wildcards).validation
        wanted = section is not None and section.fair_baseline
        return f"results/{wildcards.case}/synthesis/baseline/{name}" if wanted else []

    return path


def known_samples(wildcards):
    """The samples that the case's own bound was made of: roll-outs and borders."""
    case, point = case_of(wildcards), own_point(case_of(wildcards))
    borders = f"results/{bordered(wildcards.case)}/borders/{point}/samples.parquet"
    shards = shard_files(simulated(wildcards.case), wildcards, point)
    return shards if remembers(case) else [*shards, borders]


rule synthesis:
    input:
        case=correction,
        gap=lambda w: f"{gap_folder(w)}/gap.json" if w.kind == "gap" else [],
    output:
        controller="results/{case}/synthesis/{kind}/controller.npz",
        summary="results/{case}/synthesis/{kind}/synthesis.json",
    log:
        "results/{case}/logs/synthesis-{kind}.log",
    benchmark:
        "results/{case}/benchmarks/synthesis-{kind}.tsv"
    priority: page_first
    threads: ONE_OR_TWO
    resources:
        mem_mb=2000,
        runtime=30,
    params:
        **of_stage("synthesis"),
        files=options(),
        baseline=lambda w: ["--baseline"] if w.kind == "baseline" else [],
    message:
        "{wildcards.case}: controller for the {wildcards.kind} model"
    shell:
        "simgap synthesis {params.case:q} {params.files:q} {params.baseline:q}"
        " --out {output.controller:q} --summary {output.summary:q} --workers {threads} --log {log:q}"


rule validation:
    input:
        case=correction,
        nominal="results/{case}/synthesis/nominal/controller.npz",
        gap_aware="results/{case}/synthesis/gap/controller.npz",
        baseline=baseline_file("controller.npz"),
        gap=lambda w: f"{gap_folder(w)}/gap.json",
    output:
        summary="results/{case}/{tier}validation/validation.json",
        traces="results/{case}/{tier}validation/traces.parquet",
    log:
        "results/{case}/{tier}logs/validation.log",
    benchmark:
        "results/{case}/{tier}benchmarks/validation.tsv"
    priority: page_first
    threads: ONE_OR_TWO
    resources:
        mem_mb=3000,
        runtime=60,
    params:
        **of_stage("validation"),
        files=options(),
        trials=lambda w: TRIALS[w.tier],
    message:
        "{wildcards.case}: both controllers in closed loop ({params.trials} trials, {threads} at a time)"
    shell:
        "simgap validation {params.case:q} {params.files:q} --out {output.summary:q} --traces {output.traces:q}"
        " --trials {params.trials} --workers {threads} --log {log:q}"


rule audit:
    input:
        case=correction,
        gap=lambda w: f"{gap_folder(w)}/gap.json",
        controller="results/{case}/synthesis/gap/controller.npz",
        rollouts=known_samples,
        fresh=lambda w: f"results/{simulated(w.case, 'fresh')}/fresh/samples.parquet",
        after=ancient("results/{case}/validation/validation.json"),
    output:
        counts="results/{case}/{tier}audit/audit.json",
        margins="results/{case}/{tier}audit/margins.parquet",
    log:
        "results/{case}/{tier}logs/audit.log",
    benchmark:
        "results/{case}/{tier}benchmarks/audit.tsv"
    priority: long_first
    threads: ONE_OR_TWO
    resources:
        mem_mb=3000,
        runtime=60,
    params:
        **of_stage("audit"),
        witness=lambda w: f"results/{w.case}/{w.tier}audit/witness.json",
        trials=lambda w: TRIALS[w.tier],
        files=options("after"),
    message:
        "{wildcards.case}: an adversary against bound and controller ({params.trials} trials, {threads} at a time)"
    shell:
        "simgap audit {params.case:q} {params.files:q} --out {output.counts:q} --margins {output.margins:q}"
        " --witness {params.witness:q} --trials {params.trials} --workers {threads} --log {log:q}"


def own_shards(wildcards):
    """Roll-outs on the grid that the case's own bound was made from."""
    return shard_files(wildcards.case, wildcards, own_point(case_of(wildcards)))


rule twin:
    input:
        case=correction,
        rollouts=own_shards,
        fresh="results/{case}/fresh/samples.parquet",
        traces="results/{case}/validation/traces.parquet",
    output:
        "results/{case}/twin/twin.json",
    log:
        "results/{case}/logs/twin.log",
    benchmark:
        "results/{case}/benchmarks/twin.tsv"
    resources:
        mem_mb=1500,
        runtime=30,
    params:
        **of_stage("twin"),
        files=options(),
    message:
        "{wildcards.case}: the simulator held against the engine that it stands for"
    shell:
        "simgap twin {params.case:q} {params.files:q} --out {output:q} --log {log:q}"


rule trace:
    input:
        nominal="results/{case}/synthesis/nominal/controller.npz",
        gap_aware="results/{case}/synthesis/gap/controller.npz",
        traces="results/{case}/validation/traces.parquet",
        case=correction,
    output:
        "results/{case}/trace/trace.rrd",
    log:
        "results/{case}/logs/trace.log",
    benchmark:
        "results/{case}/benchmarks/trace.tsv"
    priority: LAST
    resources:
        mem_mb=1000,
        runtime=10,
    params:
        **of_stage("trace"),
        files=options(),
    message:
        "{wildcards.case}: recording of both controllers for Rerun"
    shell:
        "simgap trace {params.case:q} {params.files:q} --out {output:q} --log {log:q}"
