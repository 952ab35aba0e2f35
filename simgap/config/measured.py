"""The section `measured`: where recordings are, which column is which state, what is known of a file."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BeforeValidator, ConfigDict, Field, model_validator

from simgap import reading
from simgap.config.base import Interval, Positive, Section
from simgap.errors import UserError, excerpt


def bare_column(value: object) -> object:
    """A bare name is the name of the column."""
    return {"column": value} if isinstance(value, str) else value


class Condition(Section):
    """Under which conditions a file was recorded: `file`, and parameters of the plant with their values there."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, float] = Field(init=False)

    file: str
    """The file (its name, or the end of its path)."""

    @property
    def values(self) -> dict[str, float]:
        """Parameter -> value."""
        return dict(self.__pydantic_extra__)

    @model_validator(mode="after")
    def _says_something(self) -> Condition:
        if not self.__pydantic_extra__:
            raise ValueError("a condition names a file and a parameter of the plant at least: add one, such as m: 2.0")
        return self


class ConditionColumn(Section):
    """Column of a parameter that differs from file to file: `scale * (cell in the parameter's unit)`."""

    column: str
    """Name of the column; it has one value within a file, or within a trace of it."""
    unit: str | None = None
    """Unit of the cells, such as g or mV; if not given, the unit stored with a Parquet column, else the unit of the
    parameter."""
    scale: float = 1.0
    """Factor on the converted cell."""

    @model_validator(mode="after")
    def _says_something(self) -> ConditionColumn:
        if self.scale == 0.0:
            raise ValueError("scale is 0, which throws the column away: give a factor")
        return self


_SIGNS = "*?["
MOST_FILES = 10_000
"""Files that a pattern may stand for."""


def matching_files(folder: Path, names: Sequence[str], typed: bool = False) -> list[tuple[int, Path]]:
    """The files behind names, each with the place of the name that brought it.

    A name with `*`, `?` or `[` that is no file itself stands for the files of the folder that match it, sorted; `**`
    for folders below. A name that nothing matches stays as it is, and a file that several names bring comes once.

    Args:
        folder: where names start from; names: as `measured.files` lists them.
        typed: whether a person typed them, who may look anywhere; a case may come from a stranger.

    Raises:
        UserError: a pattern that leads out of the folder, or matches too much.
    """
    found: dict[Path, int] = {}
    for place, name in enumerate(names):
        path = folder / name
        hits = [path]
        if any(s in name for s in _SIGNS) and not path.exists():
            hits = _files(folder, name, None if typed else f"measured.files.{place}") or [path]
        for hit in hits:
            found.setdefault(hit, place)
    return [(place, path) for path, place in found.items()]


def named_recordings(case: Path, names: Sequence[str]) -> list[Path]:
    """The recordings that a case file names under `measured.files`.

    Raises:
        UserError: one that is not there, or a pattern that no file matches.
    """
    found = matching_files(case.parent, names)
    for place, path in found:
        if not reading.is_file(path):
            problem = f"{'is a folder' if path.is_dir() else 'there is no file'}: '{names[place]}'"
            remedy = "Correct the path, which starts from the folder of the case; quote a name with a comma."
            raise UserError(problem, file=case, key=f"measured.files.{place}", remedy=remedy)
    return [path for _, path in found]


def _files(folder: Path, pattern: str, key: str | None) -> list[Path]:
    """Files that match, sorted; none where it is no pattern (`**` stands alone between slashes)."""
    anchor = Path(pattern).anchor
    if key is not None and (anchor or ".." in Path(pattern).parts):
        remedy = "Name the files one by one, or put the case beside them."
        raise UserError(f"the pattern '{excerpt(pattern, 60)}' leads out of the case's folder", key=key, remedy=remedy)
    try:
        found = list(islice((folder / anchor).glob(pattern.removeprefix(anchor)), MOST_FILES + 1))
    except ValueError:
        return []
    if len(found) > MOST_FILES:
        problem = f"the pattern '{excerpt(pattern, 60)}' stands for more than {MOST_FILES} files"
        raise UserError(problem, key=key, remedy="Narrow it.")
    return sorted(path for path in found if reading.is_file(path))


Range = Annotated[Interval, Field(description="From and to, in seconds as the time column reads.")]


class ColumnMap(Section):
    """Column of a state or an input, and how its cells become the case's numbers.

    The value is `scale * (cell converted from unit to the case's unit) + offset`.
    """

    column: str | None = None
    """Name of the column; the name of the state or input if not given."""
    unit: str | None = None
    """Unit of the cells, such as deg or rpm; if not given, the unit stored with a Parquet column, else the unit of the
    state."""
    scale: float = 1.0
    """Factor on the converted cell: a gear ratio, or -1 for a reversed axis."""
    offset: float | str = 0.0
    """Added after scaling, in the unit of the state; a number or an expression such as -pi (a recording that hangs at
    pi for a model that hangs at 0)."""
    wrapped: bool | None = None
    """Whether the cells jump by a full turn; if not given, an angle that stays within one turn and jumps by more than
    half a turn between neighbours is unwrapped."""
    constant: float | None = None
    """The value of an input that was not recorded because it was held, such as 0 for no drive."""

    @model_validator(mode="after")
    def _one_source(self) -> ColumnMap:
        if self.constant is not None and (self.column is not None or self.unit is not None):
            raise ValueError("a constant has neither a column nor a unit: remove one of them")
        if self.scale == 0.0:
            raise ValueError("scale is 0, which throws the column away: give a factor")
        return self


class TimeMap(Section):
    """The column of time stamps."""

    column: str = "t"
    """Name of the column of time stamps."""
    unit: str | None = None
    """Unit of the stamps, such as ms or ns; if not given, what a Parquet file says, else s. They may start anywhere."""
    gap_s: float | None = Field(None, gt=0)
    """A longer interval splits a trace in two; if not given, five times the interval that 95 % of the samples keep."""


class Mask(Section):
    """A stretch of time to keep or to drop, such as the time after another controller took over."""

    file: str | None = None
    """File to which the range applies (its name, or the end of its path); every file if not given."""
    trace: str | None = None
    """Value of the trace column to which the range applies; every trace if not given."""
    keep: Range | None = None
    """Keep only this time range of the file."""
    drop: Range | None = None
    """Drop this time range of the file."""

    @model_validator(mode="after")
    def _one_range(self) -> Mask:
        if (self.keep is None) == (self.drop is None):
            raise ValueError("a mask has either keep or drop")
        return self


class HeldOut(Section):
    """The data that no effect is fitted to, on which the error before and after is judged."""

    files: tuple[str, ...] = ()
    """Files held out (their names, or the ends of their paths)."""
    traces: tuple[str, ...] = ()
    """Values of the trace column held out."""
    fraction: float = Field(0.25, gt=0, lt=1)
    """Where no file or trace is named: this share of the traces if there are enough, else of the time, in blocks of
    windows."""


class PayloadSection(Section):
    """Something more that was mounted on a link while a file was recorded."""

    file: str
    """The file (its name, or the end of its path)."""
    link: str
    """The link on which it was mounted; a joint must move it."""
    mass: float | None = Field(None, gt=0)
    """Its mass in kg, if known; otherwise the mass is estimated."""


class MeasuredSection(Section):
    """Recordings of the real thing, for `simgap diagnose` and the diagnosis stage."""

    OPTIONAL = ("conditions", "conditions_from", "payloads", "into_simulator", "known")

    files: tuple[str, ...] = ()
    """CSV, Parquet, JSON or MCAP files, relative to the case file, or patterns (runs/*.csv, in the order of their
    names); files on the command line replace them."""
    columns: dict[str, Annotated[ColumnMap, BeforeValidator(bare_column, str | ColumnMap)]] = Field(
        default_factory=dict
    )
    """For a state or an input: its column, if it is not a column of the same name."""
    time: Annotated[TimeMap, BeforeValidator(bare_column, str | TimeMap)] = Field(default_factory=TimeMap)
    """The column of time stamps."""
    trace_column: str = "trace"
    """Column that separates the traces of one file, if there is one."""
    masks: tuple[Mask, ...] = ()
    """Time ranges to keep or to drop."""
    conditions: tuple[Condition, ...] = ()
    """Parameters of the plant that are known to differ from file to file, such as a weight or a supply voltage; a file
    that is not named has the declared values. One set of effects is fitted to all files."""
    conditions_from: dict[str, Annotated[ConditionColumn, BeforeValidator(bare_column, str | ConditionColumn)]] = Field(
        default_factory=dict
    )
    """Such parameters with their values in a column of each file (or beside the samples of a JSON file): parameter ->
    its column."""
    payloads: tuple[PayloadSection, ...] = ()
    """Weights that were mounted on a link of an arm of three joints or more in some files."""
    held_out: HeldOut = Field(default_factory=HeldOut)
    """Data that are held out for the verdict."""
    window_s: float = Field(1.0, gt=0)
    """Length of the windows that are simulated in the fit, in seconds: about what the plant takes to answer its input.
    1 s suits most machines; give a slow plant (tanks, heat) more, so that what it lacks shows above the noise."""
    horizon_s: float = Field(0.5, gt=0)
    """How far ahead of the causal initial state the error E(h) is reported, in seconds. Where nothing explains the data
    down to their noise, sets of effects compete by that error: take what the controller looks ahead."""
    noise: dict[str, Positive] = Field(default_factory=dict)
    """Standard deviation of a channel's noise, in the unit of the state, where it is known; estimated from the data
    elsewhere."""
    effects: tuple[str, ...] = ()
    """Effects that may be tried; if none is named, all of `simgap effects` but lugre_friction and
    elasticity_behind_encoder."""
    known: tuple[str, ...] = ()
    """Parameters of the plant that are not in doubt, such as gravity or a length that was measured: no error of theirs
    is sought."""
    max_effects: int | None = Field(None, ge=1, le=6)
    """Largest number of effects in one explanation (if not given 5; if more than noise is left, each beyond the third
    must halve the squared error); of an arm of three joints or more, at each joint (3 if not given)."""
    budget_s: float | None = Field(None, gt=0)
    """Limit of the CPU seconds of search and verdict. When they are spent, the last answer that was judged is
    reported, with a remark; it may differ between machines. No limit if not given."""
    confidence: float = Field(0.95, gt=0.5, lt=1)
    """Requested coverage of the conformal bound on what no effect explains."""
    rig: Literal["simulator", "hardware"] = "hardware"
    """What was recorded. hardware (or another engine): effects go into the nominal model, and into the simulator where
    it lacks them (`into_simulator`); simulator (the case's own): into the nominal model alone."""
    into_simulator: bool | None = None
    """hardware: whether the simulator of the corrected case also simulates the effects. By default the version with the
    smaller error on the confirming recordings is taken; where that cannot be decided, a simulator made of the nominal
    model gets them and one with a model of its own does not."""

    @property
    def recorded(self) -> bool:
        """True if a run diagnoses recordings: the case's own, or those of the simulator in place of the plant."""
        return bool(self.files) or self.rig == "simulator"

    @model_validator(mode="after")
    def _one_source_each(self) -> MeasuredSection:
        twice = [name for name in self.conditions_from if any(name in c.values for c in self.conditions)]
        if twice:
            raise ValueError(f"{twice} are both in conditions and in conditions_from: remove them from one")
        return self
