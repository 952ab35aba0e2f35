# What a person looks at: the recording, the page of a case, and the page that links them.

TEMPLATES = digest(
    {path.name: file_digest(path) for path in sorted(Path("reports").glob("*"))}
)


def pages(case):
    """What a person looks at."""
    names = ("report.html", "summary.json", "trace/trace.rrd")
    return [f"results/{case}/{name}" for name in names]


def final_results(case):
    """What a plain run makes of a case."""
    folder = f"results/{case}"
    return [*pages(case), "results/index.html"] + (
        [f"{folder}/diagnosis/report.html", f"{folder}/corrected/report.html"]
        if diagnosed(case)
        else []
    )


def gap_files(wildcards):
    """The bounds in the table of eps; a corrected case has its own point alone."""
    corrected = wildcards.case != base(wildcards.case)
    own = [own_point(case_of(wildcards))]
    points = own if corrected else sweep_points(wildcards.case)
    return [f"results/{wildcards.case}/gap/{point}/gap.json" for point in points]


def diagnosis_file(wildcards):
    """What measured data said: made if the case has recordings, shown if a person has made it."""
    path = f"results/{wildcards.case}/diagnosis/diagnosis.json"
    wanted = wildcards.case == base(wildcards.case) and diagnosed(wildcards.case)
    return path if wanted or Path(path).exists() else []


def corrected_files(wildcards):
    """The corrected case's figures and controllers, to stand beside the first ones."""
    if wildcards.case != base(wildcards.case) or not diagnosed(wildcards.case):
        return []
    folder = f"results/{wildcards.case}/corrected"
    return [
        f"{folder}/summary.json",
        *(f"{folder}/synthesis/{kind}/controller.npz" for kind in ("nominal", "gap")),
    ]


def report_options(wildcards, input):
    folder = f"results/{wildcards.case}"
    diagnosis = [f"{folder}/diagnosis"] if input.diagnosis else []
    corrected = [f"{folder}/corrected"] if input.corrected else []
    return flagged("--diagnosis", diagnosis) + flagged("--corrected", corrected)


rule trace:
    input:
        nominal="results/{case}/synthesis/nominal/controller.npz",
        robust="results/{case}/synthesis/gap/controller.npz",
        traces="results/{case}/validation/traces.parquet",
        case=correction,
    output:
        "results/{case}/trace/trace.rrd",
    log:
        "results/{case}/logs/trace.log",
    benchmark:
        "results/{case}/benchmarks/trace.tsv"
    resources:
        mem_mb=1000,
        runtime=10,
    params:
        case=lambda w: case_path(w.case),
        reads=reads("trace"),
        code=code("trace"),
    message:
        "{wildcards.case}: recording of both controllers for Rerun"
    shell:
        "simgap trace {params.case:q} --nominal {input.nominal:q} --robust {input.robust:q} --traces {input.traces:q}"
        " --out {output:q} --log {log:q}"


rule report:
    input:
        gaps=gap_files,
        samples=lambda w: f"{gap_folder(w)}/samples.parquet",
        nominal=multiext(
            "results/{case}/synthesis/nominal/", "controller.npz", "synthesis.json"
        ),
        robust=multiext(
            "results/{case}/synthesis/gap/", "controller.npz", "synthesis.json"
        ),
        validation=multiext(
            "results/{case}/validation/", "validation.json", "traces.parquet"
        ),
        diagnosis=diagnosis_file,
        corrected=corrected_files,
        case=correction,
    output:
        page="results/{case}/report.html",
        summary="results/{case}/summary.json",
    log:
        "results/{case}/logs/report.log",
    benchmark:
        "results/{case}/benchmarks/report.tsv"
    resources:
        mem_mb=1500,
        runtime=10,
    params:
        case=lambda w: case_path(w.case),
        reads=reads("report"),
        code=code("report"),
        templates=TEMPLATES,
        gaps=lambda w, input: flagged("--gap", input.gaps),
        more=report_options,
    message:
        "{wildcards.case}: the page"
    shell:
        "simgap report {params.case:q} {params.gaps:q} --samples {input.samples:q}"
        " --nominal results/{wildcards.case:q}/synthesis/nominal --robust results/{wildcards.case:q}/synthesis/gap"
        " --validation results/{wildcards.case:q}/validation {params.more:q}"
        " --out {output.page:q} --summary {output.summary:q} --log {log:q}"


rule index:
    input:
        expand("results/{case}/summary.json", case=CASES),
    output:
        "results/index.html",
    log:
        "results/logs/index.log",
    resources:
        mem_mb=300,
        runtime=5,
    params:
        code=code("index"),
        templates=TEMPLATES,
        summaries=lambda w, input: flagged("--summary", input),
    message:
        "Page that links the reports of all cases"
    shell:
        "simgap index {params.summaries:q} --out {output:q} --log {log:q}"
