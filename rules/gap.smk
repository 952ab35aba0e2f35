# The bound of the gap: scp and lipschitz, one job a dimension, then gap, which puts the dimensions together.


def states_of(case):
    """Names of the states, in order; what was found on hardware may have added some."""
    if case == base(case) or simulated(case) == base(case):
        return list(case_of(case).plant.states)
    return list(
        load_case(
            Path(checkpoints.diagnosis.get(case=base(case)).output.corrected)
        ).plant.states
    )


def dimensions(stage):
    """Results of a stage for all dimensions, in the order of the states; points of a sweep share those that are alike."""
    return lambda wildcards: [
        f"results/{maker(wildcards.case, stage)}/gap/{wildcards.point}/{stage}/{state}.json"
        for state in states_of(wildcards.case)
    ]


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
        "results/{case}/gap/{point}/scp/{state}.json",
    log:
        "results/{case}/logs/scp-{point}-{state}.log",
    benchmark:
        "results/{case}/benchmarks/scp-{point}-{state}.tsv"
    priority: page_first
    resources:
        mem_mb=2000,
        runtime=30,
    params:
        case=lambda w: case_path(w.case),
        grid=grid_folder,
        reads=reads("scp"),
        code=code("scp"),
        shards=lambda w, input: flagged("--rollouts", input.rollouts),
        borders=lambda w, input: flagged("--borders", input.borders),
    message:
        "{wildcards.case}: scenario program of {wildcards.state}, {wildcards.point}"
    shell:
        "simgap scp {params.case:q} --state {wildcards.state:q} --grid {params.grid:q} {params.shards:q}"
        " {params.borders:q} --out {output:q} --log {log:q}"


rule lipschitz:
    input:
        case=correction,
        grid=grid_files,
        rollouts=shards,
    output:
        "results/{case}/gap/{point}/lipschitz/{state}.json",
    log:
        "results/{case}/logs/lipschitz-{point}-{state}.log",
    benchmark:
        "results/{case}/benchmarks/lipschitz-{point}-{state}.tsv"
    priority: page_first
    resources:
        mem_mb=2000,
        runtime=30,
    params:
        case=lambda w: case_path(w.case),
        grid=grid_folder,
        reads=reads("lipschitz"),
        code=code("lipschitz"),
        shards=lambda w, input: flagged("--rollouts", input.rollouts),
    message:
        "{wildcards.case}: Lipschitz constant of {wildcards.state}, {wildcards.point}"
    shell:
        "simgap lipschitz {params.case:q} --state {wildcards.state:q} --grid {params.grid:q} {params.shards:q}"
        " --out {output:q} --log {log:q}"


rule gap:
    input:
        case=correction,
        grid=grid_files,
        rollouts=shards,
        scp=dimensions("scp"),
        lipschitz=dimensions("lipschitz"),
        fresh=lambda w: f"results/{simulated(w.case, 'fresh')}/fresh/samples.parquet",
        calibration=calibration,
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
        case=lambda w: case_path(w.case),
        grid=grid_folder,
        reads=reads("gap"),
        code=code("gap"),
        shards=lambda w, input: flagged("--rollouts", input.rollouts),
        scp=lambda w, input: flagged("--scp", input.scp),
        lipschitz=lambda w, input: flagged("--lipschitz", input.lipschitz),
        drawn=lambda w, input: flagged("--calibration", input.calibration),
        borders=lambda w, input: flagged("--borders", input.borders),
    message:
        "{wildcards.case}: dimensions put together, padded and checked on fresh samples, {wildcards.point}"
    shell:
        "simgap gap {params.case:q} --grid {params.grid:q} {params.shards:q} {params.scp:q} {params.lipschitz:q}"
        " --fresh {input.fresh:q} {params.drawn:q} {params.borders:q} --out {output.gap:q} --samples {output.samples:q} --log {log:q}"
