"""Options of a question from the fields of its option values."""

import dataclasses
import inspect

import ziegler_jax as zj

VALUES = {
    "method": zj.Method,
    "windows": zj.Windows,
    "spans": zj.Spans,
    "search": zj.Search,
    "directions": zj.Directions,
    "arc": zj.Arc,
    "course": zj.Course,
    "section": zj.SectionPlane,
}


def options_of(question, **given):
    """The keywords of `question`, in which fields of its option values stand alone.

    `options_of(zj.settle, rtol=1e-4, length=5.0)` is `{"method": Method(rtol=1e-4),
    "windows": Windows(length=5.0)}`.
    """
    parameters, fields = inspect.signature(question).parameters, {}
    for keyword, kind in VALUES.items():
        if keyword in parameters:
            for field in dataclasses.fields(kind):
                if field.name not in parameters:
                    fields.setdefault(field.name, keyword)
    options, values = {}, {}
    for name, value in given.items():
        if name in fields:
            values.setdefault(fields[name], {})[name] = value
        else:
            options[name] = value
    return options | {k: VALUES[k](**part) for k, part in values.items()}
