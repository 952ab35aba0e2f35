# Samples of the simulator: grid -> rollouts for the bound; random ones that check it.
#
# Every case takes this road. {point} is what the grid is made for: a radius of the balls that cover X (eps~0.0022), or, where
# the simulator remembers earlier inputs, a grid of these (hidden-state, full-table).


def grid_folder(wildcards):
    return f"results/{simulated(wildcards.case)}/grid/{wildcards.point}"


def grid_files(wildcards):
    return multiext(f"{grid_folder(wildcards)}/", "states.parquet", "inputs.parquet")


def shard_files(of, wildcards, point):
    """Roll-outs on the grid of a point, made of the case that is named `of`."""
    count = shard_count(case_of(wildcards))
    return [f"results/{of}/rollouts/{point}/shard-{k}.parquet" for k in range(count)]


def shards(wildcards):
    return shard_files(simulated(wildcards.case), wildcards, wildcards.point)


# What a person would want to know before anything runs. It goes first, and its failure ends the run; nothing depends on it,
# because Snakemake looks for changes only behind jobs that need not run.
rule check:
    input:
        case=correction,
    output:
        "results/{case}/check/check.json",
    log:
        "results/{case}/logs/check.log",
    benchmark:
        "results/{case}/benchmarks/check.tsv"
    priority: lambda w: 100 if w.case == CASES[0] else 15
    resources:
        mem_mb=500,
        runtime=5,
    params:
        **of_stage("check"),
    message:
        "{wildcards.case}: model file, engine, cells and costs"
    shell:
        "simgap check {params.case:q} --out {output:q} --log {log:q}"


rule grid:
    input:
        case=correction,
    output:
        multiext("results/{case}/grid/{point}/", "states.parquet", "inputs.parquet"),
    log:
        "results/{case}/logs/grid-{point}.log",
    benchmark:
        "results/{case}/benchmarks/grid-{point}.tsv"
    priority: page_first
    resources:
        mem_mb=500,
        runtime=5,
    params:
        **of_stage("grid"),
        out=lambda w, output: Path(output[0]).parent,
    message:
        "{wildcards.case}: states that cover X and inputs, {wildcards.point}"
    shell:
        "simgap grid {params.case:q} --point {wildcards.point:q} --out {params.out:q} --log {log:q}"


rule rollouts:
    input:
        case=correction,
        grid=multiext(
            "results/{case}/grid/{point}/", "states.parquet", "inputs.parquet"
        ),
    output:
        "results/{case}/rollouts/{point}/shard-{shard}.parquet",
    log:
        "results/{case}/logs/rollouts-{point}-{shard}.log",
    benchmark:
        "results/{case}/benchmarks/rollouts-{point}-{shard}.tsv"
    priority: page_first
    resources:
        mem_mb=1500,
        runtime=120,
    params:
        **of_stage("rollouts"),
        grid=lambda w, input: Path(input.grid[0]).parent,
    message:
        "{wildcards.case}: simulator on grid x inputs, {wildcards.point}, shard {wildcards.shard}"
    shell:
        "simgap rollouts {params.case:q} --grid {params.grid:q} --shard {wildcards.shard:q} --out {output:q} --log {log:q}"


rule fresh:
    input:
        case=correction,
    output:
        "results/{case}/fresh/samples.parquet",
    log:
        "results/{case}/logs/fresh.log",
    benchmark:
        "results/{case}/benchmarks/fresh.tsv"
    priority: page_first
    threads: ONE_OR_TWO
    resources:
        mem_mb=1500,
        runtime=30,
    params:
        **of_stage("fresh"),
    message:
        "{wildcards.case}: fresh random samples of the simulator"
    shell:
        "simgap fresh {params.case:q} --out {output:q} --workers {threads} --log {log:q}"


rule borders:
    input:
        case=correction,
    output:
        "results/{case}/borders/{point}/samples.parquet",
    log:
        "results/{case}/logs/borders-{point}.log",
    benchmark:
        "results/{case}/benchmarks/borders-{point}.tsv"
    priority: page_first
    resources:
        mem_mb=1500,
        runtime=30,
    params:
        **of_stage("borders"),
    message:
        "{wildcards.case}: simulator on borders and beside switching surfaces, {wildcards.point}"
    shell:
        "simgap borders {params.case:q} --point {wildcards.point:q} --out {output:q} --log {log:q}"


def borders(wildcards):
    """The corrected model may switch where the case does not, so it has its own; a gap over histories has no border."""
    if remembers(case_of(wildcards)):
        return []
    return (
        f"results/{bordered(wildcards.case)}/borders/{wildcards.point}/samples.parquet"
    )


def bordered(name):
    """The case whose samples on borders count: its own, but for points of a sweep that need the same."""
    return simulated(name, "borders") if sweep_of(name) is not None else name
