"""The dashboard asks for figures that there are."""

import json
import re
from pathlib import Path

from tests.service.samples import body

DASHBOARD = Path(__file__).parents[3] / "docker" / "grafana" / "rollcast.json"


def test_every_panel_asks_for_known_figures(client):
    client.post("/predict", json=body(horizon=3))
    client.post("/predict", json=body(horizon=0))
    told = client.get("/metrics").text
    panels = json.loads(DASHBOARD.read_text("utf-8"))["panels"]
    assert panels
    for panel in panels:
        for target in panel["targets"]:
            names = re.findall(r"\b(?:rollcast|http)_[a-z_]+", target["expr"])
            assert names
            for name in names:
                (line,) = re.findall(rf"^{name}\{{(.*)\}} ", told, re.MULTILINE)[:1]
                labels = set(re.findall(r"(\w+)=", line))
                grouped = re.search(r"by \(([^)]+)\)", target["expr"])
                assert grouped is not None
                assert set(grouped[1].split(", ")) <= labels, (name, labels)
