def test_every_version_is_listed_with_its_status(client):
    models = {f"{m['name']}@{m['version']}": m for m in client.get("/models").json()["models"]}
    assert list(models) == ["between@1", "bowl@1", "broken@1", "dot@1", "dot@2", "line@1", "pair@1"]
    assert models["dot@1"] == {
        "name": "dot",
        "version": 1,
        "default": True,
        "status": "ready",
        "reason": None,
        "variant": "dotnet",
        "preset": "fake",
        "scenarios": ["hemisphere", "ellipsoid", "heightfield"],
        "objects": 1,
        "frame_rate_hz": 40.0,
        "frame_rates_hz": None,
        "setup": None,
        "frames": 4,
        "max_objects": None,
        "final_step": None,
        "trained_horizon": 20,
        "covariance_source": "predicted",
        "angular_velocity": True,
        "metrics": {"validation_error_px": 3.0, "rows": []},
    }
    assert models["broken@1"]["status"] == "invalid"
    assert models["broken@1"]["reason"] == "manifest.json is missing"
    assert models["broken@1"]["variant"] is None


def test_a_name_means_its_default_version(client):
    model = client.get("/models/dot").json()
    assert (model["version"], model["versions"]) == (1, [1, 2])
    assert (model["card"], model["licence"]) == ("# A card\n", "Apache-2.0")


def test_one_version(client):
    model = client.get("/models/dot/versions/2").json()
    assert (model["version"], model["default"]) == (2, False)


def test_a_refused_version_is_shown_too(client):
    model = client.get("/models/broken/versions/1").json()
    assert (model["status"], model["card"]) == ("invalid", None)
