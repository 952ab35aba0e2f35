# The bound of a robot's gap over every previous and every present input: `snakemake --cores 2 full_table`.
#
# Nothing depends on it. It shows what the smaller grid of previous inputs of a plain run misses, and costs several times
# as much: 441 x 441 roll-outs for 441 inputs.


rule full_table:
    input:
        [
            f"results/{case}/full-table/gap.json"
            for case in CASES
            if LOADED[case].hidden_state is not None
        ],


rule full_histories:
    output:
        grid="results/{case}/full-table/previous.parquet",
        random="results/{case}/full-table/random.parquet",
        memory="results/{case}/full-table/memory.json",
    log:
        "results/{case}/logs/full-histories.log",
    benchmark:
        "results/{case}/benchmarks/full-histories.tsv"
    threads: 2
    resources:
        mem_mb=3000,
        runtime=120,
    params:
        case=lambda w: case_path(w.case),
        reads=reads("histories"),
        code=code("histories"),
    message:
        "{wildcards.case}: the simulator on every pair of previous and present input, {threads} processes"
    shell:
        "simgap histories {params.case:q} --every --out {output.grid:q} --random {output.random:q}"
        " --memory {output.memory:q} --workers {threads} --log {log:q}"


rule full_gap:
    input:
        grid="results/{case}/full-table/previous.parquet",
        random="results/{case}/full-table/random.parquet",
        memory="results/{case}/full-table/memory.json",
        fresh="results/{case}/fresh/samples.parquet",
    output:
        gap="results/{case}/full-table/gap.json",
        samples="results/{case}/full-table/samples.parquet",
    log:
        "results/{case}/logs/full-gap.log",
    resources:
        mem_mb=3000,
        runtime=10,
    params:
        case=lambda w: case_path(w.case),
        reads=reads("hidden_gap"),
        code=code("hidden_gap"),
    message:
        "{wildcards.case}: bound of the gap over every previous input"
    shell:
        "simgap hidden-gap {params.case:q} --grid {input.grid:q} --random {input.random:q} --memory {input.memory:q}"
        " --fresh {input.fresh:q} --out {output.gap:q} --samples {output.samples:q} --log {log:q}"
