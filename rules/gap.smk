# Roll-outs of the simulator, fresh samples, and the bound of the gap.


rule rollouts:
    output:
        "results/{case}/rollouts/eps~{eps}/shard-{shard}.parquet",
    log:
        "results/{case}/logs/rollouts-eps~{eps}-{shard}.log",
    benchmark:
        "results/{case}/benchmarks/rollouts-eps~{eps}-{shard}.tsv"
    params:
        case=lambda w: case_path(w.case),
        reads=reads("rollouts"),
        code=code("rollouts"),
    resources:
        mem_mb=1500,
        runtime=30,
    message:
        "{wildcards.case}: simulator on grid x inputs, eps = {wildcards.eps}, shard {wildcards.shard}"
    shell:
        "simgap rollouts {params.case} --eps {wildcards.eps} --shard {wildcards.shard} --out {output} --log {log}"


rule fresh:
    output:
        "results/{case}/fresh/samples.parquet",
    log:
        "results/{case}/logs/fresh.log",
    benchmark:
        "results/{case}/benchmarks/fresh.tsv"
    params:
        case=lambda w: case_path(w.case),
        reads=reads("fresh"),
        code=code("fresh"),
    resources:
        mem_mb=1500,
        runtime=30,
    message:
        "{wildcards.case}: fresh random samples of the simulator"
    shell:
        "simgap fresh {params.case} --out {output} --workers {threads} --log {log}"


def shards(wildcards):
    count = case_of(wildcards).grid.shards
    return expand(
        "results/{case}/rollouts/eps~{eps}/shard-{shard}.parquet",
        case=base(wildcards.case),
        eps=wildcards.eps,
        shard=range(count),
    )


rule gap:
    input:
        case=correction,
        rollouts=shards,
        fresh=lambda w: f"results/{base(w.case)}/fresh/samples.parquet",
    output:
        gap="results/{case}/gap/eps~{eps}/gap.json",
        samples="results/{case}/gap/eps~{eps}/samples.parquet",
    log:
        "results/{case}/logs/gap-eps~{eps}.log",
    benchmark:
        "results/{case}/benchmarks/gap-eps~{eps}.tsv"
    params:
        case=lambda w: case_path(w.case),
        reads=reads("gap"),
        code=code("gap"),
        shards=lambda w, input: " ".join(f"--rollouts {path}" for path in input.rollouts),
    resources:
        mem_mb=3000,
        runtime=30,
    message:
        "{wildcards.case}: Lipschitz estimates, scenario programs and gap function, eps = {wildcards.eps}"
    shell:
        "simgap gap {params.case} --eps {wildcards.eps} {params.shards} --fresh {input.fresh}"
        " --out {output.gap} --samples {output.samples} --log {log}"
