"""Parameters that are read and set by name, in scikit-learn's form but without loading it."""

from __future__ import annotations

import inspect
from typing import Any, Self

from optkit.basics.errors import InputError


class Parameters:
    """What value functions are made with, by name: the arguments of ``__init__``, kept under their own names.

    :func:`sklearn.base.clone` takes such objects like scikit-learn's own estimators, whose base class would add two
    seconds to the start of every process.

    Examples
    --------
    >>> class Share(Parameters):
    ...     def __init__(self, share: float = 0.5) -> None:
    ...         self.share = share
    >>> Share().set_params(share=0.7)
    Share(share=0.7)
    >>> Share().get_params()
    {'share': 0.5}
    """

    @classmethod
    def _defaults(cls) -> dict[str, Any]:
        # An object's own signature, which a class without an __init__ has, is no list of parameters.
        made = cls.__init__
        if made is object.__init__:
            return {}
        _, *parameters = inspect.signature(made).parameters.values()
        return {one.name: one.default for one in sorted(parameters, key=lambda one: one.name)}

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """Return parameters by name.

        Parameters
        ----------
        deep : bool
            As scikit-learn asks; no parameter has parameters of its own.
        """
        return {name: getattr(self, name) for name in self._defaults()}

    def set_params(self, **parameters: Any) -> Self:
        """Set parameters by name, and return the object.

        Parameters
        ----------
        **parameters : any
            They count at the next fit.

        Raises
        ------
        InputError
            If there is no such parameter.
        """
        known = list(self._defaults())
        for name in parameters:
            if name not in known:
                raise InputError(f"Invalid parameter {name!r} for {self}: it has {', '.join(known) or 'none'}")
        for name, value in parameters.items():
            setattr(self, name, value)
        return self

    def __repr__(self) -> str:
        """Show the parameters that differ from their defaults."""
        defaults = self._defaults()
        told = {name: (repr(value), repr(defaults[name])) for name, value in self.get_params().items()}
        return f"{type(self).__name__}({', '.join(f'{k}={own}' for k, (own, usual) in told.items() if own != usual)})"
