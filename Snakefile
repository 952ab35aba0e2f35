# simgap: from a model and a simulator to a controller that survives the gap between them.
#
#   snakemake --cores 2                                  every default case, then the report
#   snakemake --cores 2 paper                            what the paper's printed numbers allow
#   snakemake --cores 2 full                             the same with more trials: 1,000 starts, 1e6 steps of the adversary
#   snakemake --cores 2 full_table                       a robot's gap over every previous input (long)
#   snakemake --cores 2 audit_deep                       the adversary, ten times as hard, on cases that remember (long)
#   snakemake --cores 2 sensing                          the pendulum, measured with an error and a sample late
#   snakemake --cores 2 sensing_robot                    the robot, measured with an error and a sample late
#   snakemake --cores 2 mujoco                           the pendulum in another engine (extra `mujoco`)
#   snakemake --cores 2 textbook                         small cases in equations: converter and motor
#   snakemake --cores 2 cart_pole                        a pole on a cart from its URDF, four states
#   snakemake --cores 2 two_link                         an arm of two links, reach and avoid in joint space
#   snakemake --cores 2 two_link_friction                the same with dry friction that its model lacks
#   snakemake --cores 2 pioneer                          a wheeled robot of another make, through a door into a dock
#   snakemake --cores 2 tasks                            formulas: a courier, a swing-up, an arm that picks and places, a cart-pole
#   snakemake --cores 2 servo                            a real servo: its recordings, corrected model, bound, controller
#   snakemake --cores 2 proven                           the pendulum against equations: a bound without estimates
#   snakemake --report results/report.zip                what is there, every page and figure with its caption, in one file


configfile: "configs/default.yaml"


report: "reports/captions/workflow.rst"


include: "rules/common.smk"
include: "rules/cases.smk"
include: "rules/samples.smk"
include: "rules/gap.smk"
include: "rules/control.smk"
include: "rules/diagnosis.smk"
include: "rules/results.smk"
include: "rules/report.smk"
include: "rules/sweep.smk"
include: "rules/paper.smk"


# Of all that is written around an error its reason is the last that a person reads, and it has a page.
onerror:
    import atexit
    from simgap.cli.workflow import failures, write_failed

    failed = failures([Path(path) for path in log])
    words = {f"results/{n}": case.no_controller for n, case in LOADED.items()}
    told = [f"Page: {page}" for page in write_failed(failed, words)] + [
        *map(str, failed)
    ]
    atexit.register(
        lambda: sys.stderr.write("".join(f"\nsimgap: {t}\n" for t in told))
    )


localrules:
    all,
    full,
    audit_deep,
    full_table,
    sensing,
    sensing_robot,
    mujoco,
    proven,
    textbook,
    cart_pole,
    two_link,
    two_link_friction,
    pioneer,
    servo,
    tasks,


rule all:
    default_target: True
    input:
        [path for case in CASES for path in final_results(case)],


# The numbers of trials that a published figure wants: pages in results/<case>/full. Bounds and controllers are those of a plain
# run; what grows is the evidence beside them, and its confidence.
rule full:
    input:
        [path for case in CASES for path in full_results(case)],


# The bound of a robot's gap over every previous and every present input. Nothing depends on it: it shows what the smaller
# grid of previous inputs of a plain run misses, and costs several times as much.
rule full_table:
    input:
        [
            f"results/{case}/gap/{EVERY_HISTORY}/gap.json"
            for case in CASES
            if remembers(LOADED[case])
        ],


# The adversary with ten times the budget of a plain run, against cases that remember.
rule audit_deep:
    input:
        [
            f"results/{case}/deep/audit/audit.json"
            for case in CASES
            if remembers(LOADED[case])
        ],


rule sensing:
    input:
        pages("pendulum_sensing"),


rule sensing_robot:
    input:
        pages("turtlebot_sensing"),


rule mujoco:
    input:
        pages("pendulum_mujoco"),


rule proven:
    input:
        pages("pendulum_proven"),


rule textbook:
    input:
        pages("dcdc") + pages("dc_motor"),


rule cart_pole:
    input:
        pages("cart_pole"),


rule tasks:
    input:
        pages("courier")
        + pages("swing_up")
        + pages("pick_and_place")
        + pages("to_and_fro"),


rule two_link:
    input:
        pages("two_link"),


rule two_link_friction:
    input:
        pages("two_link_friction"),


rule pioneer:
    input:
        pages("pioneer"),


# The recordings are not included; the head of the case says what they are.
rule servo:
    input:
        pages("go1_servo"),
