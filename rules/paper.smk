# What the paper's printed numbers allow: `snakemake --cores 2 paper`.

PAPER = sorted(Path("configs/paper").glob("*.yaml"))
PAPER_CASES = [path for path in PAPER if path.name != "printed.yaml"]


rule paper:
    input:
        PAPER,
        pendulum=str(CASE_FOLDER / "pendulum.yaml"),
    output:
        "results/paper/paper.json",
    log:
        "results/paper/paper.log",
    benchmark:
        "results/paper/paper.tsv"
    threads: 2
    resources:
        mem_mb=2000,
        runtime=20,
    params:
        reads=lambda w: sections_digest(
            case_of("pendulum"), READS["paper"], CASE_FOLDER
        ),
        code=lambda w: digest(
            [
                code("paper", "pendulum")(w),
                *(
                    code_digest("paper", load_case(Path(p)), Path(p).parent)
                    for p in PAPER_CASES
                ),
            ]
        ),
    message:
        "The paper's printed numbers: what they allow, and reproduced values beside them"
    shell:
        "simgap paper configs/paper --pendulum {input.pendulum:q} --out {output:q} --workers {threads} --log {log:q}"
