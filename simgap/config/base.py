"""What every section of a case file shares."""

from pydantic import BaseModel, ConfigDict


class Section(BaseModel):
    """A frozen group of keys of a case file; unknown keys are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, use_attribute_docstrings=False)
