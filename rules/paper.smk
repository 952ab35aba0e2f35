# What the paper's printed numbers allow: `snakemake --cores 2 paper`.

PAPER = sorted(Path("configs/paper").glob("*.yaml"))


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
        code=code("paper", "pendulum"),
    message:
        "The paper's printed numbers: what they allow, and reproduced values beside them"
    shell:
        "simgap paper configs/paper --pendulum {input.pendulum:q} --out {output:q} --workers {threads} --log {log:q}"
