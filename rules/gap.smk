# Roll-outs of the simulator, fresh samples, and the bound of the gap.


rule rollouts:
    input:
        case=correction,
    output:
        "results/{case}/rollouts/eps~{eps}/shard-{shard}.parquet",
    log:
        "results/{case}/logs/rollouts-eps~{eps}-{shard}.log",
    benchmark:
        "results/{case}/benchmarks/rollouts-eps~{eps}-{shard}.tsv"
    resources:
        mem_mb=1500,
        runtime=30,
    params:
        case=lambda w: case_path(w.case),
        reads=reads("rollouts"),
        code=code("rollouts"),
    message:
        "{wildcards.case}: simulator on grid x inputs, eps = {wildcards.eps}, shard {wildcards.shard}"
    shell:
        "simgap rollouts {params.case:q} --eps {wildcards.eps:q} --shard {wildcards.shard:q} --out {output:q} --log {log:q}"


rule fresh:
    input:
        case=correction,
    output:
        "results/{case}/fresh/samples.parquet",
    log:
        "results/{case}/logs/fresh.log",
    benchmark:
        "results/{case}/benchmarks/fresh.tsv"
    threads: 2
    resources:
        mem_mb=1500,
        runtime=30,
    params:
        case=lambda w: case_path(w.case),
        reads=reads("fresh"),
        code=code("fresh"),
    message:
        "{wildcards.case}: fresh random samples of the simulator"
    shell:
        "simgap fresh {params.case:q} --out {output:q} --workers {threads} --log {log:q}"


rule calibration:
    input:
        case=correction,
    output:
        "results/{case}/calibration/samples.parquet",
    log:
        "results/{case}/logs/calibration.log",
    benchmark:
        "results/{case}/benchmarks/calibration.tsv"
    threads: 2
    resources:
        mem_mb=1500,
        runtime=30,
    params:
        case=lambda w: case_path(w.case),
        reads=reads("calibration"),
        code=code("calibration"),
    message:
        "{wildcards.case}: random samples that set the width of a conformal bound"
    shell:
        "simgap calibration {params.case:q} --out {output:q} --workers {threads} --log {log:q}"


def calibration(wildcards):
    """A conformal bound needs samples of its own; the other bounds need none."""
    if case_of(wildcards).gap.bound != "conformal":
        return []
    return f"results/{simulated(wildcards.case)}/calibration/samples.parquet"


def shards(wildcards):
    count = case_of(wildcards).grid.shards
    return expand(
        "results/{case}/rollouts/eps~{eps}/shard-{shard}.parquet",
        case=simulated(wildcards.case),
        eps=wildcards.eps,
        shard=range(count),
    )


rule gap:
    input:
        case=correction,
        rollouts=shards,
        fresh=lambda w: f"results/{simulated(w.case)}/fresh/samples.parquet",
        calibration=calibration,
    output:
        gap="results/{case}/gap/eps~{eps}/gap.json",
        samples="results/{case}/gap/eps~{eps}/samples.parquet",
    log:
        "results/{case}/logs/gap-eps~{eps}.log",
    benchmark:
        "results/{case}/benchmarks/gap-eps~{eps}.tsv"
    resources:
        mem_mb=3000,
        runtime=30,
    params:
        case=lambda w: case_path(w.case),
        reads=reads("gap"),
        code=code("gap"),
        shards=lambda w, input: flagged("--rollouts", input.rollouts),
        drawn=lambda w, input: flagged("--calibration", input.calibration),
    message:
        "{wildcards.case}: Lipschitz estimates, scenario programs and gap function, eps = {wildcards.eps}"
    shell:
        "simgap gap {params.case:q} --eps {wildcards.eps:q} {params.shards:q} --fresh {input.fresh:q}"
        " {params.drawn:q} --out {output.gap:q} --samples {output.samples:q} --log {log:q}"


rule histories:
    input:
        case=correction,
    output:
        grid="results/{case}/histories/previous.parquet",
        random="results/{case}/histories/random.parquet",
        memory="results/{case}/histories/memory.json",
    log:
        "results/{case}/logs/histories.log",
    benchmark:
        "results/{case}/benchmarks/histories.tsv"
    threads: 2
    resources:
        mem_mb=2000,
        runtime=60,
    params:
        case=lambda w: case_path(w.case),
        reads=reads("histories"),
        code=code("histories"),
    message:
        "{wildcards.case}: what earlier inputs leave behind in the simulator, {threads} processes"
    shell:
        "simgap histories {params.case:q} --out {output.grid:q} --random {output.random:q} --memory {output.memory:q}"
        " --workers {threads} --log {log:q}"


rule hidden_gap:
    input:
        case=correction,
        grid=lambda w: f"results/{simulated(w.case)}/histories/previous.parquet",
        random=lambda w: f"results/{simulated(w.case)}/histories/random.parquet",
        memory=lambda w: f"results/{simulated(w.case)}/histories/memory.json",
        fresh=lambda w: f"results/{simulated(w.case)}/fresh/samples.parquet",
    output:
        gap="results/{case}/gap/hidden-state/gap.json",
        samples="results/{case}/gap/hidden-state/samples.parquet",
    log:
        "results/{case}/logs/hidden-gap.log",
    benchmark:
        "results/{case}/benchmarks/hidden-gap.tsv"
    resources:
        mem_mb=2000,
        runtime=10,
    params:
        case=lambda w: case_path(w.case),
        reads=reads("hidden_gap"),
        code=code("hidden_gap"),
    message:
        "{wildcards.case}: bound of the gap over the hidden state, seen from the robot"
    shell:
        "simgap hidden-gap {params.case:q} --grid {input.grid:q} --random {input.random:q} --memory {input.memory:q}"
        " --fresh {input.fresh:q} --out {output.gap:q} --samples {output.samples:q} --log {log:q}"
