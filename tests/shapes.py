"""Check the shapes and dtypes that the package's annotations promise, at every call.

`check` is the type checker that jaxtyping's import hook puts around every function and dataclass. It looks at array annotations
only: whether anything else is what it says is pyright's to tell, and beartype, which the hook is made for, refuses a method that
returns `Self` and a field whose axis (N−1) comes before the one it depends on.
"""

import functools
import inspect
import typing

import jaxtyping


def arrays_in(hint):
    """Array types in an annotation: itself, or members of a union."""
    for part in typing.get_args(hint) or (hint,):
        if isinstance(part, type) and issubclass(part, jaxtyping.AbstractArray):
            yield part


def holds(value, hint):
    """Whether a value is one of the array types of an annotation, or nothing that has a shape."""
    allowed = list(arrays_in(hint))
    return not allowed or not hasattr(value, "shape") or any(isinstance(value, one) for one in allowed)


def symbolic(hint):
    """Whether a shape is computed from axes that another argument has to bind first."""
    return any(set("+-*/") & set(one.dim_str) for one in arrays_in(hint))


def check(function):
    """`function`, refusing arrays that are not what its annotations say."""
    signature = inspect.signature(function)
    hints = {name: x.annotation for name, x in signature.parameters.items() if any(arrays_in(x.annotation))}
    result = signature.return_annotation
    if not hints and not any(arrays_in(result)):
        return function

    @functools.wraps(function)
    def checked(*args, **kwargs):
        given = signature.bind(*args, **kwargs).arguments
        for name in sorted(hints, key=lambda name: symbolic(hints[name])):
            if name in given and not holds(given[name], hints[name]):
                what = f"{given[name].dtype}{list(given[name].shape)}"
                raise TypeError(f"{function.__qualname__}: {name} is {what}, where {hints[name]} is promised")
        found = function(*args, **kwargs)
        if not holds(found, result):
            raise TypeError(f"{function.__qualname__} returns {found.dtype}{list(found.shape)}, where {result} is promised")
        return found

    return checked


def install():
    """Check every module of the package imported from now on."""
    return jaxtyping.install_import_hook("slippulse_jax", "shapes.check")
