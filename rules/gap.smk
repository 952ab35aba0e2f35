# The bound of the gap: scp and lipschitz, dimension by dimension, then gap, which puts the dimensions together.


def dimensions(stage):
    """Results of a stage for all dimensions; points of a sweep share those that are alike."""
    return lambda w: f"results/{maker(w.case, stage)}/gap/{w.point}/{stage}.json"


def maker(name, stage):
    """The case whose results of this stage count: its own, but for points of a sweep that need the same."""
    if sweep_of(name) is None:
        return name
    return first_alike(name, ("grid", "rollouts", "borders", stage), base_too=False)


# Neither of the next two waits for the other, whatever the padding. `inflate` puts local paddings into the scenario
# program: they come from the slopes of the residual at each cell, so fit and padding take turns inside `scp`, which takes
# these slopes from the roll-outs itself. `per_axis` and `paper` add the constants of `lipschitz` after the program, in
# `gap`: a change from one to the other reruns `gap` alone.
rule scp:
    input:
        case=correction,
        grid=grid_files,
        rollouts=shards,
        borders=borders,
    output:
        "results/{case}/gap/{point}/scp.json",
    log:
        "results/{case}/logs/scp-{point}.log",
    benchmark:
        "results/{case}/benchmarks/scp-{point}.tsv"
    priority: page_first
    resources:
        mem_mb=2000,
        runtime=30,
    params:
        **of_stage("scp"),
        grid=grid_folder,
        files=options("grid"),
    message:
        "{wildcards.case}: scenario programs, {wildcards.point}"
    shell:
        "simgap scp {params.case:q} --grid {params.grid:q} {params.files:q} --out {output:q} --log {log:q}"


rule lipschitz:
    input:
        case=correction,
        grid=grid_files,
        rollouts=shards,
    output:
        "results/{case}/gap/{point}/lipschitz.json",
    log:
        "results/{case}/logs/lipschitz-{point}.log",
    benchmark:
        "results/{case}/benchmarks/lipschitz-{point}.tsv"
    priority: page_first
    resources:
        mem_mb=2000,
        runtime=30,
    params:
        **of_stage("lipschitz"),
        grid=grid_folder,
        files=options("grid"),
    message:
        "{wildcards.case}: Lipschitz constants, {wildcards.point}"
    shell:
        "simgap lipschitz {params.case:q} --grid {params.grid:q} {params.files:q} --out {output:q} --log {log:q}"


rule gap:
    input:
        case=correction,
        grid=grid_files,
        rollouts=shards,
        scp=dimensions("scp"),
        lipschitz=dimensions("lipschitz"),
        fresh=lambda w: f"results/{simulated(w.case, 'fresh')}/fresh/samples.parquet",
        borders=borders,
    output:
        gap="results/{case}/gap/{point}/gap.json",
        samples="results/{case}/gap/{point}/samples.parquet",
    log:
        "results/{case}/logs/gap-{point}.log",
    benchmark:
        "results/{case}/benchmarks/gap-{point}.tsv"
    priority: page_first
    resources:
        mem_mb=2000,
        runtime=30,
    params:
        **of_stage("gap"),
        grid=grid_folder,
        files=options("grid"),
    message:
        "{wildcards.case}: dimensions put together, padded and checked on fresh samples, {wildcards.point}"
    shell:
        "simgap gap {params.case:q} --grid {params.grid:q} {params.files:q}"
        " --out {output.gap:q} --samples {output.samples:q} --log {log:q}"
