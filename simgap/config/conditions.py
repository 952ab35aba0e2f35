"""Known conditions of a file: parameters of the plant, stated file by file or held by a column."""

from __future__ import annotations

from pydantic import ConfigDict, Field, model_validator

from simgap.config.base import Section


def bare_column(value: object) -> object:
    """A bare name is the name of the column."""
    return {"column": value} if isinstance(value, str) else value


class Condition(Section):
    """Under which conditions a file was recorded: `file`, and parameters of the plant with their values there."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, float] = Field(init=False)

    file: str = Field(description="The file (its name, or the end of its path).")

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
    """Which column holds a parameter that differs from file to file: `scale * (cell in the parameter's unit)`."""

    column: str = Field(description="Name of the column; it has one value within a file, or within a trace of it.")
    unit: str | None = Field(
        default=None,
        description="Unit of the cells, such as g or mV; if not given, the unit stored with a Parquet column, else "
        "the unit of the parameter.",
    )
    scale: float = Field(default=1.0, description="Factor on the converted cell.")

    @model_validator(mode="after")
    def _says_something(self) -> ConditionColumn:
        if self.scale == 0.0:
            raise ValueError("scale is 0, which throws the column away: give a factor")
        return self
