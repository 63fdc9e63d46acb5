"""The Python client of the service.

>>> from rollcast.client import Client
>>> with Client("http://127.0.0.1:8000") as client:  # doctest: +SKIP
...     scene = client.simulate("hemisphere", seed=7)
...     forecast = client.predict(scene.frames[:4], horizon=40)
...     forecast.positions.shape
(1, 40, 2)

Exceptions: ``rollcast.errors.ClientError`` and its heirs.
"""

from rollcast.client.images import Crop, Frame
from rollcast.client.results import Forecast, Simulation
from rollcast.client.sync import Client

__all__ = ["Client", "Crop", "Forecast", "Frame", "Simulation"]
