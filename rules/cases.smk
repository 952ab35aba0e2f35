# Which case a name means: of the config, a point of a sweep, or one that a diagnosis corrected; and where its file stands.


def base(name):
    """The case that a corrected case came from."""
    return name.split("/")[0]


def simulated(name, *stages):
    """The case whose roll-outs count: effects found on the simulator leave it as it is, those found on hardware do not.

    Points of a sweep that need the same roll-outs (or what else the stages make) share those of the first of them.
    """
    if sweep_of(name) is not None:
        return first_alike(name, stages or ("grid", "rollouts"))
    if base(name) not in LOADED:
        LOADED[base(name)] = load(base(name))
    measured = LOADED[base(name)].measured
    hardware = measured is not None and measured.rig == "hardware"
    return name if hardware else base(name)


def sweep_of(name):
    """The sweep file of which a case is a point, if it is one."""
    path = Path(SETTINGS.sweep_folder) / f"{name.partition(MARK)[0]}.yaml"
    return path if MARK in name and path.is_file() else None


SWEPT = {}


def swept(path):
    """The points of a sweep file, by name."""
    if path not in SWEPT:
        try:
            SWEPT[path] = {point.name: point for point in points_of_sweep(path)}
        except SimgapError as error:
            told(error)
    return SWEPT[path]


def first_alike(name, stages, base_too=True):
    """The first of the sweep's case (if `base_too`) and its points that needs the same of these stages, whatever its name."""
    path = sweep_of(name)
    cases = {point: swept(path)[point].case for point in swept(path)}
    own = base_of(path)
    beside = own.parent.resolve() == CASE_FOLDER.resolve()
    if base_too and beside and own.stem not in cases:
        cases = {own.stem: case_of(own.stem)} | cases

    def needs(case):
        nameless = case.model_copy(update={"name": "any"})
        sections = [sections_of(stage, case) for stage in stages]
        return [sections_digest(nameless, part, own.parent) for part in sections]

    return next(n for n, case in cases.items() if needs(case) == needs(cases[name]))


def folder_of(name):
    """Where the relative paths of a case start from."""
    path = sweep_of(name)
    return CASE_FOLDER if path is None else base_of(path).parent


def case_path(name):
    if sweep_of(name) is not None:
        return f"results/sweeps/{name.partition(MARK)[0]}/cases/{name}.yaml"
    if name != base(name):
        return f"results/{base(name)}/diagnosis/corrected_case.yaml"
    return str(CASE_FOLDER / f"{name}.yaml")


def correction(wildcards):
    """A file that a rule makes is an input, but what the stages read of it is hashed, as of any case, and not the file.

    Asking the checkpoint has the hashes taken again once the diagnosis has run.
    """
    if sweep_of(wildcards.case) is not None:
        return ancient(case_path(wildcards.case))
    if wildcards.case == base(wildcards.case):
        return []
    made = checkpoints.diagnosis.get(case=base(wildcards.case)).output.corrected
    return ancient(made)


def read_of(name):
    """What a job reads: the case and its folder; of a corrected case its own file, once there is one."""
    path = Path(case_path(name))
    if sweep_of(name) is None and name != base(name) and path.is_file():
        try:
            return load_case(path), path.parent
        except SimgapError:
            pass  # of an earlier version: the diagnosis makes it again
    return case_of(name), folder_of(name)


def load(name):
    path = sweep_of(name)
    if path is not None:
        if name not in swept(path):
            told(
                UserError(
                    "has no such point",
                    file=path,
                    key=name,
                    remedy="Its values have changed.",
                )
            )
        return swept(path)[name].case
    try:
        return load_case(Path(case_path(name)))
    except SimgapError as error:
        told(error)


LOADED = {name: load(name) for name in CASES}


def case_of(wildcards):
    """The case, given by its name or by wildcards, or the one that it came from: they differ in the nominal model."""
    name = base(wildcards if isinstance(wildcards, str) else wildcards.case)
    if name not in LOADED:
        LOADED[name] = load(name)
    return LOADED[name]
