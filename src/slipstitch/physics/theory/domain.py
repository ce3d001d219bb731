"""The range of arguments in which a law is valid."""

import math

from slipstitch.base.errors import BadInput


def require(
    name: str,
    value: float,
    lowest: float,
    highest: float = math.inf,
    *,
    open_below: bool = False,
    open_above: bool = False,
) -> float:
    """Return ``value`` as a float, or refuse it in one line.

    Parameters
    ----------
    name : str
        What the value is, with its unit, as the message shows it.
    value : float
        The value itself.
    lowest, highest : float
        The allowed range.
    open_below, open_above : bool
        Whether that end itself is excluded; an infinite end always is.

    Returns
    -------
    float
        The value.

    Raises
    ------
    BadInput
        If the value is no finite number or lies outside the range.
    """
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise BadInput(f"{name} must be a number, not {value!r}") from None
    below = number <= lowest if open_below else number < lowest
    above = number >= highest if open_above else number > highest
    if not math.isfinite(number) or below or above:
        lower = f"{'above' if open_below else 'at least'} {lowest:g}"
        upper = (
            ""
            if math.isinf(highest)
            else f" and {'below' if open_above else 'at most'} {highest:g}"
        )
        raise BadInput(f"{name} must be {lower}{upper}, not {number:g}")
    return number
