"""The page's files: what its browser may do, what it may keep, and whose libraries they are."""

import re

import pytest

from rollcast.scene import SceneParameters
from rollcast.trajectory import FRAME_RATE_HZ
from service.http.routes.home import STATIC

SCRIPTS = sorted(path.relative_to(STATIC).as_posix() for path in STATIC.glob("app/*.js"))


def test_the_page_lets_nothing_in_but_its_own(client):
    page = client.get("/")
    policy = page.headers["content-security-policy"].split("; ")
    assert "default-src 'self'" in policy
    assert {"object-src 'none'", "base-uri 'none'", "frame-ancestors 'none'"} <= set(policy)
    assert "unsafe" not in page.headers["content-security-policy"]
    assert page.headers["cache-control"] == "no-cache"


def test_the_page_has_no_code_or_style_within(client):
    text = client.get("/").text
    assert re.findall(r"<script(?![^>]*\bsrc=)", text) == []
    assert "<style" not in text
    assert re.findall(r"\s(?:style|on[a-z]+)=", text) == []


def test_every_file_that_the_page_names_is_there(client):
    names = re.findall(r'(?:src|href)="(static/[^"]+)"', client.get("/").text)
    assert len(names) >= 6
    for name in names:
        assert client.get(f"/{name}").status_code == 200, name


@pytest.mark.parametrize("script", SCRIPTS)
def test_every_file_that_a_script_imports_is_there(script: str):
    text = (STATIC / script).read_text()
    for name in re.findall(
        r'^(?:import|export)\b.*? from "([^"]+)"', text, re.MULTILINE | re.DOTALL
    ):
        assert ((STATIC / script).parent / name).is_file(), name


def test_the_panel_of_a_scene_has_the_limits_of_the_service():
    text = (STATIC / "app/scene_panel.js").read_text("utf-8")
    number = r"\{ name: \"(\w+)\", label: \"[^\"]+\", min: ([\d.]+), max: ([\d.]+)"
    limits = {name: (float(low), float(high)) for name, low, high in re.findall(number, text)}
    del limits["start_step"]
    assert len(limits) >= 10
    fields = SceneParameters.model_json_schema()["properties"]
    known = {name: fields[name]["anyOf"][0] for name in limits}
    assert limits == {name: (field["minimum"], field["maximum"]) for name, field in known.items()}


def test_the_page_has_the_rate_of_simulations():
    (rate,) = re.findall(
        r"^export const FRAME_RATE_HZ = ([\d.]+);$",
        (STATIC / "app/state.js").read_text("utf-8"),
        re.MULTILINE,
    )
    assert float(rate) == FRAME_RATE_HZ


def test_a_file_is_asked_for_anew_and_sent_once(client):
    first = client.get("/static/app/main.js")
    assert first.headers["content-type"].split(";")[0].endswith("/javascript")
    assert first.headers["cache-control"] == "no-cache"
    assert first.headers["x-content-type-options"] == "nosniff"
    again = client.get("/static/app/main.js", headers={"If-None-Match": first.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")
    assert again.headers["cache-control"] == "no-cache"


@pytest.mark.parametrize("path", ["nothing.js", "../app.py", "%2e%2e/app.py", "app"])
def test_what_is_not_there(client, path: str):
    response = client.get(f"/static/{path}")
    assert response.status_code == 404
    assert response.json()["type"] == "/problems/not-found"


def test_libraries_come_with_their_licences():
    vendored = [folder for folder in (STATIC / "vendor").iterdir() if folder.is_dir()]
    notice = (STATIC / "vendor/README.md").read_text()
    assert len(vendored) == 3
    for folder in vendored:
        (licence,) = folder.glob("LICENSE*")
        assert "Permission is hereby granted, free of charge" in licence.read_text()
        assert f"`{folder.name}/`" in notice
    size = sum(path.stat().st_size for path in (STATIC / "vendor").rglob("*") if path.is_file())
    assert size < 1.5e6


def test_nothing_is_named_that_lies_elsewhere():
    for path in STATIC.rglob("*"):
        if path.suffix in {".js", ".css", ".html"} and "vendor" not in path.parts:
            text = path.read_text()
            if path.parent.name == "guide":  # whose prose names addresses
                text = " ".join(re.findall(r'(?:src|href)="[^"]*"', text))
            assert "://" not in text, path


def test_texts_are_compressed_for_those_who_take_that(client):
    for path in ("/", "/static/app/main.js", "/static/vendor/three/three.core.min.js"):
        plain = client.get(path, headers={"Accept-Encoding": "identity"})
        small = client.get(path, headers={"Accept-Encoding": "gzip"})
        assert "content-encoding" not in plain.headers
        assert small.headers["content-encoding"] == "gzip"
        assert small.content == plain.content
        assert int(small.headers["content-length"]) < 0.5 * len(plain.content)
        for answer in (plain, small):
            assert "Accept-Encoding" in answer.headers["vary"]
            assert answer.headers["cache-control"] == "no-cache"
        assert small.headers["content-type"] == plain.headers["content-type"]


def test_a_compressed_file_that_has_not_changed_is_not_sent_again(client):
    compressed = {"Accept-Encoding": "gzip"}
    first = client.get("/static/app/main.js", headers=compressed)
    known = compressed | {"If-None-Match": first.headers["etag"]}
    again = client.get("/static/app/main.js", headers=known)
    assert (again.status_code, again.content) == (304, b"")


def test_a_three_dimensional_library_is_not_loaded_with_the_page():
    needed, unread = set(), ["app/main.js"]
    while unread:
        script = unread.pop()
        needed.add(script)
        text = (STATIC / script).read_text()
        for name in re.findall(r'^import\b.*? from "([^"]+)"', text, re.MULTILINE | re.DOTALL):
            path = ((STATIC / script).parent / name).resolve().relative_to(STATIC).as_posix()
            if path not in needed:
                unread.append(path)
    assert "app/session.js" in needed
    assert not [script for script in needed if "three" in script]
