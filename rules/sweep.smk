# A sweep: its points are cases like any other, its table and page stand over their results.


wildcard_constraints:
    sweep="[a-z][a-z0-9_]*(-[a-z0-9_]+)*",


def sweep_file(wildcards):
    return Path(SETTINGS.sweep_folder) / f"{wildcards.sweep}.yaml"


def point_digest(path, name):
    """Of the content of a point, and of plug-ins that are copied along."""
    point = swept(path)[name]
    return digest(
        [point.content, code_digest("rollouts", point.case, base_of(path).parent)]
    )


def point_result(name):
    """What a point has to show: its summary, or its bound where no controller is asked for."""
    case = case_of(name)
    if case.synthesis is not None:
        return f"results/{name}/summary.json"
    return f"results/{name}/gap/{own_point(case)}/gap.json"


rule point:
    output:
        "results/sweeps/{sweep}/cases/{case}.yaml",
    log:
        "results/sweeps/{sweep}/logs/{case}.log",
    resources:
        mem_mb=500,
        runtime=5,
    params:
        sweep=sweep_file,
        content=lambda w: point_digest(sweep_file(w), w.case),
    message:
        "{wildcards.case}: the case of this point"
    shell:
        "simgap point {params.sweep:q} {wildcards.case:q} --out {output:q} --log {log:q}"


rule sweep:
    input:
        lambda w: [point_result(name) for name in swept(sweep_file(w))],
    output:
        page="results/sweeps/{sweep}/report.html",
        table="results/sweeps/{sweep}/table.parquet",
    log:
        "results/sweeps/{sweep}/logs/sweep.log",
    resources:
        mem_mb=500,
        runtime=5,
    params:
        sweep=sweep_file,
        content=lambda w: file_digest(sweep_file(w)),
        code=lambda w: digest([code_digest("sweep")]),
        templates=TEMPLATES,
        results=lambda w, input: flagged("--result", list(input)),
    message:
        "Sweep {wildcards.sweep}: table and page"
    shell:
        "simgap sweep-page {params.sweep:q} {params.results:q} --out {output.page:q} --table {output.table:q} --log {log:q}"
