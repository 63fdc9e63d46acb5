import pytest
from pydantic import ValidationError

from service.settings import Settings, described


def test_settings_come_from_the_environment(monkeypatch):
    monkeypatch.setenv("ROLLCAST_MAX_BODY_BYTES", "1234")
    assert Settings().max_body_bytes == 1234


def test_an_unknown_setting_is_refused(monkeypatch):
    monkeypatch.setenv("ROLLCAST_MAX_BODY", "1234")
    with pytest.raises(ValidationError, match="ROLLCAST_MAX_BODY'"):
        Settings()


@pytest.mark.parametrize("name", ["RUNS", "URL", "API_KEY", "CASES"])
def test_the_variables_of_other_programs_are_ignored(monkeypatch, name):
    monkeypatch.setenv(f"ROLLCAST_{name}", "/somewhere")
    Settings()


@pytest.mark.parametrize(
    ("name", "value"),
    [("INFERENCE_THREADS", "0"), ("PROCESSES", "two"), ("MODELS_DIR", "/no/such/folder")],
)
def test_a_wrong_setting_is_refused(monkeypatch, name, value):
    monkeypatch.setenv(f"ROLLCAST_{name}", value)
    with pytest.raises(ValidationError, match=name.lower()):
        Settings()


def test_every_setting_is_described():
    assert all(field.description for field in Settings.model_fields.values())


@pytest.fixture
def file(tmp_path, monkeypatch):
    path = tmp_path / "rollcast.toml"
    monkeypatch.setenv("ROLLCAST_SETTINGS_FILE", str(path))
    return path


def test_settings_come_from_a_file_too(file):
    file.write_text("max_batch = 4\nprocesses = 2\n")
    settings = Settings()
    assert (settings.max_batch, settings.processes) == (4, 2)


def test_the_environment_goes_before_the_file(file, monkeypatch):
    file.write_text("max_batch = 4\n")
    monkeypatch.setenv("ROLLCAST_MAX_BATCH", "8")
    assert Settings().max_batch == 8


def test_an_unknown_setting_in_the_file_is_refused(file):
    file.write_text("max_bach = 4\n")
    with pytest.raises(ValidationError, match="max_bach"):
        Settings()


def test_a_file_that_is_missing_is_told(file):
    with pytest.raises(ValueError, match=r"ROLLCAST_SETTINGS_FILE.*rollcast\.toml"):
        Settings()


def test_every_setting_is_told_with_its_default():
    text = described()
    assert "ROLLCAST_MAX_BATCH (default 16)\n    Maximum number of forecasts" in text
    assert text.count("(default ") == len(Settings.model_fields)


def test_traces_have_to_go_somewhere(monkeypatch):
    with pytest.raises(
        ValidationError, match=r"traces requires one of .*OTEL_EXPORTER_OTLP_ENDPOINT"
    ):
        Settings(traces=True)
    monkeypatch.setenv("OTEL_EXPORTER_OTLP_ENDPOINT", "http://127.0.0.1:4318")
    assert Settings(traces=True).traces


def test_threads_and_queues_are_shared_out_among_processes():
    settings = Settings(processes=3, inference_threads=4, inference_queue=64, simulation_queue=8)
    share = settings.share()
    assert (share.inference_threads, share.inference_queue, share.simulation_queue) == (2, 22, 3)
    assert (
        Settings(processes=4, inference_threads=1, inference_queue=0).share().inference_threads == 1
    )


def test_requests_a_minute_are_counted_in_one_process():
    assert Settings(requests_per_minute=5).processes == 1
    with pytest.raises(ValueError, match="requests_per_minute requires processes = 1"):
        Settings(requests_per_minute=5, processes=2)


@pytest.mark.parametrize(
    "name",
    [
        "ROLLCAST_PORT",
        "ROLLCAST_PORT_8000_TCP_ADDR",
        "ROLLCAST_SERVICE_HOST",
        "ROLLCAST_SERVICE_PORT_HTTP",
        "ROLLCAST_RAY_SERVICE_PORT",
    ],
)
def test_variables_that_kubernetes_sets_for_a_service_are_no_settings(monkeypatch, name):
    """A Service named ``rollcast`` puts these into every pod of its namespace."""
    monkeypatch.setenv(name, "tcp://10.0.0.1:8000")
    Settings()
