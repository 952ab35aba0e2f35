# What a person reads: the page of a case, and the page that links them.

BASE = Path(
    workflow.basedir
)  # of a checkout, or the folder in which a wheel carries the workflow
REPORTS = next(f for f in (BASE / "reports", BASE.parent / "templates") if f.is_dir())
TEMPLATES = digest(
    {path.name: file_digest(path) for path in sorted(REPORTS.glob("*.*"))}
)
PRINTED = "configs/paper/printed.yaml"
FIRST = "first/"  # a page of bound, controller and closed loop; the adversary and the measured data follow
PAGES = {
    "": "the page",
    FIRST: "a first page, audit pending",
    "full/": "the page of the full run",
}


def page_priority(wildcards):
    """A first page before all else that is ready to run; the others fill the cores that are left at the end."""
    return 50 if wildcards.tier == FIRST else LAST


def gap_files(wildcards):
    """The case's own bound; on the page of a full run the table of eps, but for a corrected case."""
    table = wildcards.case == base(wildcards.case) and wildcards.tier == "full/"
    own = [own_point(case_of(wildcards))]
    points = sweep_points(wildcards.case) if table else own
    return [f"results/{wildcards.case}/gap/{point}/gap.json" for point in points]


def trial_file(name):
    """A result of this page's trials; the first page shows those of the plain run."""
    return lambda w: f"results/{w.case}/{'' if w.tier == FIRST else w.tier}{name}"


def audit_file(name):
    """A file of the adversary, for which the first page does not wait."""
    return lambda w: [] if w.tier == FIRST else f"results/{w.case}/{w.tier}audit/{name}"


def measured_file(name):
    """A file of the diagnosis, if the case has recordings; what is left of ones that it had counts no more."""

    def path(wildcards):
        if wildcards.tier == FIRST:
            return []
        wanted = wildcards.case == base(wildcards.case) and diagnosed(wildcards.case)
        return f"results/{wildcards.case}/diagnosis/{name}" if wanted else []

    return path


def corrected_file(name):
    """The corrected case and its results, to stand beside the first ones."""

    def path(wildcards):
        own = wildcards.case == base(wildcards.case) and wildcards.tier != FIRST
        if not own or not diagnosed(wildcards.case):
            return []
        bound = Path(gap_folder(wildcards)).name
        return (
            f"results/{wildcards.case}/{name.format(bound=bound, tier=wildcards.tier)}"
        )

    return path


def twin_file(wildcards):
    """How far the simulator is from the engine that it stands for, if it does."""
    stands = case_of(wildcards).twin is not None
    return f"results/{wildcards.case}/twin/twin.json" if stands else []


rule report:
    input:
        gap=gap_files,
        samples=lambda w: f"{gap_folder(w)}/samples.parquet",
        nominal="results/{case}/synthesis/nominal/controller.npz",
        nominal_summary="results/{case}/synthesis/nominal/synthesis.json",
        gap_aware="results/{case}/synthesis/gap/controller.npz",
        gap_aware_summary="results/{case}/synthesis/gap/synthesis.json",
        validation=trial_file("validation/validation.json"),
        traces=trial_file("validation/traces.parquet"),
        audit=audit_file("audit.json"),
        margins=audit_file("margins.parquet"),
        twin=twin_file,
        diagnosis=measured_file("diagnosis.json"),
        transitions=measured_file("transitions.parquet"),
        corrected=corrected_file("diagnosis/corrected_case.yaml"),
        corrected_gap=corrected_file("corrected/gap/{bound}/gap.json"),
        corrected_summary=corrected_file("corrected/{tier}summary.json"),
        corrected_nominal=corrected_file("corrected/synthesis/nominal/controller.npz"),
        corrected_gap_aware=corrected_file("corrected/synthesis/gap/controller.npz"),
        printed=PRINTED if Path(PRINTED).is_file() else [],
        case=correction,
    output:
        page=report(
            "results/{case}/{tier}report.html",
            caption="../reports/captions/page.rst",
            category="{case}",
            labels={"what": "the whole page"},
        ),
        summary="results/{case}/{tier}summary.json",
        picture="results/{case}/{tier}picture.png",
        figures=report(
            directory("results/{case}/{tier}figures"),
            patterns=["{name}.svg", "{name}.png"],
            caption="../reports/captions/figure.rst",
            category="{case}",
            labels={"what": "{name}"},
        ),
    log:
        "results/{case}/{tier}logs/report.log",
    benchmark:
        "results/{case}/{tier}benchmarks/report.tsv"
    priority: page_priority
    resources:
        mem_mb=1500,
        runtime=10,
    params:
        **of_stage("report"),
        templates=TEMPLATES,
        files=options(),
        later=lambda w: ["--later", "../report.html"] if w.tier == FIRST else [],
        which=lambda w: PAGES[w.tier],
    message:
        "{wildcards.case}: {params.which}"
    shell:
        "simgap report {params.case:q} {params.later:q} {params.files:q}"
        " --picture {output.picture:q} --figures {output.figures:q}"
        " --out {output.page:q} --summary {output.summary:q} --log {log:q}"


# Cases of other configs have pages too: what they made stays on the index, as it is.
def made_earlier():
    return [
        str(path)
        for path in sorted(Path("results").glob("*/summary.json"))
        if path.parent.name not in CASES
    ]


EARLIER = made_earlier()


# Runs of other cases may have ended while this one was at work, or be at work still: none of their pages is lost.
onsuccess:
    from simgap.stages.index import run as write_index

    own = [Path(f"results/{case}/summary.json") for case in CASES]
    beside = [Path(path) for path in made_earlier()]
    if RUNNING or made_earlier() != EARLIER:
        write_index([path for path in own if path.exists()], Path(INDEX), beside)


rule index:
    input:
        [f"results/{case}/summary.json" for case in CASES if controlled(case)],
    output:
        INDEX,
    log:
        "results/logs/index.log",
    resources:
        mem_mb=300,
        runtime=5,
    params:
        code=code("index"),
        templates=TEMPLATES,
        summaries=lambda w, input: flagged("--summary", input),
        earlier=flagged("--earlier", EARLIER),
    message:
        "Page that links the reports of all cases"
    shell:
        "simgap index {params.summaries:q} {params.earlier:q} --out {output:q} --log {log:q}"
