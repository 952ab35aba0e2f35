"""Sections of a case whose keys belong to a plug-in: found by name, checked by the plug-in's own frozen section."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel, GetCoreSchemaHandler, GetJsonSchemaHandler, ValidationError, ValidationInfo
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from simgap import plugins
from simgap.config.base import Section
from simgap.errors import UserError

INNER = "plugged"
"""Type of the one error that stands for all errors inside such a section; its context holds them."""


@dataclass(frozen=True)
class Plugged:
    """Annotation of a field: `Annotated[Section, Plugged("engines", "engine")]`.

    The key `tag` of the section names a plug-in of the group. The plug-in is a `Section` itself or has one as
    its `Settings`; the value of the field is an instance of that section. A file beside the case is found through the
    validation context `{"folder": ...}`.
    """

    group: str
    tag: str
    listed: tuple[str, str] | None = None

    def section(self, name: str, folder: Path | None = None) -> type[Section]:
        """The section of a plug-in.

        Raises:
            UserError: unknown name, or a plug-in without a section.
        """
        return section_of(plugins.find(self.group, name, folder), name)

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Validation by the plug-in's section, which derives from the annotated one; serialisation as its own."""
        return core_schema.with_info_plain_validator_function(
            partial(self._validate, source),
            serialization=core_schema.plain_serializer_function_ser_schema(
                lambda section, info: section.model_dump(mode=info.mode), info_arg=True
            ),
        )

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """Any of the built-in plug-ins, by the tag; other names take any keys."""
        known = [(name, self.section(name)) for name in plugins.BUILT_IN[self.group]]
        choices: list[JsonSchemaValue] = [handler(section.__pydantic_core_schema__) for _, section in known]
        choices = [choice | {"required": sorted({self.tag, *choice.get("required", ())})} for choice in choices]
        other = {"properties": {self.tag: {"type": "string", "not": {"enum": [name for name, _ in known]}}}}
        if self.listed is not None:
            choices.insert(0, {"type": "array", "items": {"type": ["string", "number"]}, "minItems": 1})
        return {"anyOf": [*choices, {"type": "object", "required": [self.tag], **other}]}

    def _validate(self, base: type[Section], value: Any, info: ValidationInfo) -> Section:
        if isinstance(value, base):
            return value
        if self.listed is not None and isinstance(value, list | tuple):
            value = {self.tag: self.listed[0], self.listed[1]: list(value)}
        if not isinstance(value, dict) or not isinstance(value.get(self.tag), str):
            known = ", ".join(plugins.names(self.group))
            raise ValueError(f"needs the key '{self.tag}', one of {known}")
        name = value[self.tag]
        try:
            section = self.section(name, (info.context or {}).get("folder"))
        except UserError as error:
            place = f"{error.file}: " if error.file else ""
            raise ValueError(f"{place}{error.problem}. {error.remedy or ''}".strip()) from None
        if not issubclass(section, base):
            raise ValueError(f"the section of '{name}' must derive from {base.__module__}.{base.__qualname__}")
        try:
            return section.model_validate(value, context=info.context)
        except ValidationError as error:
            inner = {"errors": error.errors(include_url=False), "model": section}
            raise PydanticCustomError(INNER, "the section is wrong", inner) from None


def section_of(plugin: type[Any], name: str) -> type[Section]:
    """The section of a plug-in: itself or its `Settings`.

    Raises:
        UserError: a plug-in without one, or without methods that its kind must have.
    """
    lacking = sorted(getattr(plugin, "__abstractmethods__", ()))
    if lacking:
        raise UserError(f"the plug-in '{name}' lacks {', '.join(lacking)}", remedy="Give its class these methods.")
    for candidate in (plugin, getattr(plugin, "Settings", None)):
        if isinstance(candidate, type) and issubclass(candidate, Section):
            return candidate
    raise UserError(f"the plug-in '{name}' has no section", remedy="Derive it, or its Settings, from simgap's Section.")


@dataclass(frozen=True)
class Used:
    """A plug-in that a case uses: where ('gap.basis'), of which group, which key names it ('kind') and how."""

    place: str
    group: str
    tag: str
    name: str


def used_plugins(section: BaseModel, place: str = "") -> tuple[Used, ...]:
    """The plug-ins that a section and the sections inside it name."""
    found: list[Used] = []
    for key, field in type(section).model_fields.items():
        value, here = getattr(section, key), f"{place}.{key}".lstrip(".")
        if isinstance(value, BaseModel):
            marks = [m for m in (*field.metadata, *_marks(field.annotation)) if isinstance(m, Plugged)]
            found += [Used(here, m.group, m.tag, getattr(value, m.tag)) for m in marks[:1]]
            found += used_plugins(value, here)
    return tuple(found)


def _marks(annotation: Any) -> list[Any]:
    """Marks that `Annotated` adds anywhere in an annotation, such as one side of a union."""
    inner = [mark for part in get_args(annotation) for mark in _marks(part)]
    return [*getattr(annotation, "__metadata__", ()), *inner]
