# The loop closed with measured data: recordings -> diagnosis -> corrected case -> the same stages again.
#
# A corrected case is called `<case>/corrected`. It runs on its own case file, which the diagnosis writes. What was found on the
# case's own simulator changes the nominal model alone, so the roll-outs of the case that it came from serve; what was found
# on hardware changes the simulator's twin too, which is rolled out anew.


def rig_file(case):
    path = Path(SETTINGS.rig_folder) / f"{case}.yaml"
    return path if path.is_file() else None


def rig_case(wildcards):
    """The case whose simulator is the rig, and its folder: the one that the rig file names, which may be another."""
    named = case_of_rig(rig_file(wildcards.case))
    return load_case(named), named.parent


def rig_reads(wildcards):
    """What the rig reads of its case, as a hash."""
    case, folder = rig_case(wildcards)
    return sections_digest(case, sections_of("rig", case), folder)


def rig_code(wildcards):
    """The code that moves the rig, plug-ins of its case included, as a hash."""
    of = rig_case(wildcards)
    return digest([code_digest("rig", *of), versions("rig", *of)])


def own_recordings(case):
    """The hashes of the case's own recordings, by name; one that is missing ends the plan.

    They are parameters, not inputs: a file name may hold braces, which Snakemake takes for wildcards.
    """
    measured = case_of(case).measured
    names = measured.files if measured is not None else ()
    try:
        paths = named_recordings(Path(case_path(case)), names)
        return {str(path): file_digest(path) for path in paths}
    except SimgapError as error:
        told(error)


def rig_recordings(wildcards):
    """What is diagnosed where the case names no recordings of its own: those of its rig."""
    if own_recordings(wildcards.case):
        return []
    return f"results/{wildcards.case}/rig/recordings.parquet"


def diagnosed(case):
    measured = case_of(case).measured
    return rig_file(case) is not None or (measured is not None and bool(measured.files))


rule rig:
    output:
        "results/{case}/rig/recordings.parquet",
    log:
        "results/{case}/logs/rig.log",
    benchmark:
        "results/{case}/benchmarks/rig.tsv"
    resources:
        mem_mb=1000,
        runtime=10,
    params:
        rig=lambda w: rig_file(w.case),
        content=lambda w: file_digest(rig_file(w.case)),
        reads=rig_reads,
        code=rig_code,
    message:
        "{wildcards.case}: moving and recording the rig"
    shell:
        "simgap rig {params.rig:q} --out {output:q} --log {log:q}"


# A checkpoint: on hardware the corrected case may have states that only the diagnosis knows of, such as a lagged input.
checkpoint diagnosis:
    input:
        rig_recordings,
    output:
        document="results/{case}/diagnosis/diagnosis.json",
        corrected="results/{case}/diagnosis/corrected_case.yaml",
        report=report(
            "results/{case}/diagnosis/report.html",
            caption="../reports/captions/diagnosis.rst",
            category="{case}",
            labels={"what": "diagnosis"},
        ),
        recording="results/{case}/diagnosis/residual.rrd",
        transitions="results/{case}/diagnosis/transitions.parquet",
    log:
        "results/{case}/logs/diagnosis.log",
    benchmark:
        "results/{case}/benchmarks/diagnosis.tsv"
    resources:
        mem_mb=3000,
        runtime=60,
    params:
        **of_stage("diagnosis"),
        out=lambda w, output: Path(output.document).parent,
        recordings=lambda w: own_recordings(w.case),
    message:
        "{wildcards.case}: from residuals to the effect that the model lacks"
    shell:
        "simgap diagnose {params.case:q} {input:q} --out {params.out:q} --log {log:q}"
