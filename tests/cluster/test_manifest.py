"""KubeRay's manifest holds what Ray Serve itself accepts, and deploys what the tests deploy."""

import tomllib
from pathlib import Path

import ray
import yaml
from ray._common.utils import import_attr
from ray.serve.schema import ServeDeploySchema

from service.process.ray_serve import Replica
from tests.e2e.conftest import ROOT

MANIFEST = ROOT / "docker" / "kubernetes" / "ray.yaml"
LOCK = ROOT / "uv.lock"


def manifest(path: Path = MANIFEST):
    return yaml.safe_load(path.read_text())["spec"]


def test_ray_serve_accepts_the_configuration():
    config = ServeDeploySchema.model_validate(yaml.safe_load(manifest()["serveConfigV2"]))
    (application,) = config.applications
    (deployment,) = application.deployments
    assert deployment.name == Replica.name
    built = import_attr(application.import_path)(application.args)
    assert built._bound_deployment.name == Replica.name


def test_the_cluster_has_the_rays_version_of_its_image():
    assert manifest()["rayClusterConfig"]["rayVersion"] == ray.__version__
    locked = [
        package["version"]
        for package in tomllib.loads(LOCK.read_text())["package"]
        if package["name"] == "ray"
    ]
    assert locked == [ray.__version__]
