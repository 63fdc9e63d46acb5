"""``python -m tests.contract.write_openapi``: commit the API as it is now."""

import json
from pathlib import Path

from service.app import create_app
from service.settings import Settings

PATH = Path(__file__).with_name("openapi.json")

if __name__ == "__main__":
    PATH.write_text(json.dumps(create_app(Settings()).openapi(), indent=2) + "\n")
