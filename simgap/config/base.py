"""What every section of a case file shares."""

from typing import Any, ClassVar

from pydantic import BaseModel, ConfigDict, SerializerFunctionWrapHandler, model_serializer


class Section(BaseModel):
    """A frozen group of keys of a case file; unknown keys are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, use_attribute_docstrings=False)

    OPTIONAL: ClassVar[tuple[str, ...]] = ()
    """Keys that are no part of its content while they have their default: results made before they were there hold."""

    @model_serializer(mode="wrap")
    def _without_unused(self, own: SerializerFunctionWrapHandler) -> dict[str, Any]:
        content: dict[str, Any] = own(self)
        fields = type(self).model_fields
        for key in self.OPTIONAL:
            if getattr(self, key) == fields[key].get_default(call_default_factory=True):
                content.pop(key, None)
        return content
