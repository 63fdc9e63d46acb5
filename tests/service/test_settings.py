import pytest
from pydantic import ValidationError

from service.settings import Settings


def test_settings_come_from_the_environment(monkeypatch):
    monkeypatch.setenv("ROLLCAST_MAX_BODY_BYTES", "1234")
    assert Settings().max_body_bytes == 1234


def test_an_unknown_setting_is_refused(monkeypatch):
    monkeypatch.setenv("ROLLCAST_MAX_BODY", "1234")
    with pytest.raises(ValidationError, match="ROLLCAST_MAX_BODY'"):
        Settings()


def test_the_variables_of_the_training_are_left_alone(monkeypatch):
    monkeypatch.setenv("ROLLCAST_RUNS", "/somewhere")
    Settings()


@pytest.mark.parametrize(
    ("name", "value"),
    [("INFERENCE_THREADS", "0"), ("RETRY_AFTER_S", "soon"), ("MODELS_DIR", "/no/such/folder")],
)
def test_a_wrong_setting_is_refused(monkeypatch, name, value):
    monkeypatch.setenv(f"ROLLCAST_{name}", value)
    with pytest.raises(ValidationError, match=name.lower()):
        Settings()


def test_every_setting_is_described():
    assert all(field.description for field in Settings.model_fields.values())
