# What a run makes of a case, as far as its sections go.

INDEX = "results/index.html"


def pages(case):
    """What a person looks at; what was checked before anything else first."""
    names = (
        "check/check.json",
        "first/report.html",
        "report.html",
        "summary.json",
        "trace/trace.rrd",
    )
    return [f"results/{case}/{name}" for name in names]


def bounded(case):
    """Whether a case asks for a bound of its gap."""
    return case_of(case).gap is not None or case_of(case).hidden_state is not None


def controlled(case):
    """Whether it asks for a controller, and so for a report."""
    return bounded(case) and case_of(case).synthesis is not None


def final_results(case):
    """What a plain run makes of a case, as far as its sections go."""
    folder, sections = f"results/{case}", case_of(case)
    if not controlled(case):
        own = f"{folder}/gap/{own_point(sections)}/gap.json" if bounded(case) else None
        bound = [own] if own else []
        found = [f"{folder}/diagnosis/report.html"] if diagnosed(case) else []
        return [f"{folder}/check/check.json", *bound, *found]
    return (
        [*pages(case)]
        + ([] if RUNNING else [INDEX])
        + (
            [f"{folder}/diagnosis/report.html", f"{folder}/corrected/report.html"]
            if diagnosed(case)
            else []
        )
    )


def full_results(case):
    """Everything of a plain run, and the pages with the numbers of trials of a full one."""
    also = [f"results/{case}/full/report.html"] if controlled(case) else []
    more = (
        [f"results/{case}/corrected/full/report.html"]
        if also and diagnosed(case)
        else []
    )
    return [*final_results(case), *also, *more]
