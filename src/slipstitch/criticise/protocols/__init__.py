"""The protocols of measurement: for each, its files, its features and their forward model.

A further protocol is one file like ``incline.py`` and its entry below: case reader, features,
inference, prediction and report take everything from there.
"""

from collections.abc import Mapping

from slipstitch.criticise.protocols.drag import DRAG
from slipstitch.criticise.protocols.drop_drag import DROP_DRAG
from slipstitch.criticise.protocols.incline import INCLINE
from slipstitch.criticise.protocols.protocol import Protocol, Quantity
from slipstitch.criticise.protocols.push import PUSH
from slipstitch.criticise.protocols.spring_slider import SPRING_SLIDER
from slipstitch.criticise.protocols.strip import STRIP

_IN_ORDER = (INCLINE, STRIP, DRAG, DROP_DRAG, SPRING_SLIDER, PUSH)
PROTOCOLS: Mapping[str, Protocol] = {protocol.name: protocol for protocol in _IN_ORDER}
QUANTITIES: Mapping[str, Quantity] = {q.name: q for one in _IN_ORDER for q in one.quantities}
INSTRUMENT_QUANTITIES = tuple(name for name, q in QUANTITIES.items() if q.instrument)
