"""KubeRay's manifest holds what Ray Serve itself accepts, and deploys what the tests deploy."""

from pathlib import Path

import ray
import yaml
from ray._common.utils import import_attr
from ray.serve.schema import ServeDeploySchema

from service.process.ray_serve import Replica
from tests.e2e.conftest import ROOT

MANIFEST = ROOT / "docker" / "kubernetes" / "ray.yaml"
LOCK = ROOT / "requirements" / "ray.txt"


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
    assert f"ray=={ray.__version__} " in LOCK.read_text()


def test_ray_is_in_the_locks_that_name_it_alone():
    with_ray = {
        path.stem
        for path in LOCK.parent.glob("*.txt")
        if any(line.startswith("ray==") for line in path.read_text().splitlines())
    }
    assert with_ray == {"ray", "cluster", "peer-ray"}
