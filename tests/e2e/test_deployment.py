"""The files of ``docker/`` and the documented commands start the service in its own world.

Each gives its environment to the real service, started as the image starts it, together with what
Kubernetes, Docker and a company's proxy put there; its user is in no file.
"""

import json
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import yaml

import rollcast
from tests.e2e.conftest import ROOT, SERVICE_PYTHON
from tests.e2e.container import World, in_container

DOCKER = ROOT / "docker"
DOCKERFILE = (DOCKER / "service.Dockerfile").read_text("utf-8")
VERSION = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["version"]
BASE = "kubernetes/base/rollcast.yaml"
OVERLAYS = ("local", "production")
"""Kustomizations of the base, each for a kind of cluster."""
GUIDE = ROOT / "docs/guide/deployment.md"
PROXIES = ("http_proxy", "HTTP_PROXY", "https_proxy", "HTTPS_PROXY", "all_proxy", "ALL_PROXY")


@dataclass(frozen=True)
class Deployment:
    """What a file or a command gives to a container."""

    image: str
    environment: Mapping[str, str]
    mounts: tuple[str, ...] = ()


def documents(name: str) -> list[Any]:
    return list(yaml.safe_load_all((DOCKER / name).read_text("utf-8")))


def of_pod(spec: Any) -> Deployment:
    (container,) = spec["containers"]
    environment = {one["name"]: one.get("value", "pod-1") for one in container["env"]}
    mounts = tuple(one["mountPath"] for one in container["volumeMounts"])
    return Deployment(container["image"], environment, mounts)


def of_command(command: str) -> Deployment:
    """Read ``docker run``."""
    words = shlex.split(command.replace('"$(id -u):$(id -g)"', "1:1"))
    options = {"-e": [], "-v": [], "-p": [], "--tmpfs": [], "--user": []}
    rest = iter(words[2:])
    image = ""
    for word in rest:
        if word in options:
            options[word].append(next(rest))
        elif not word.startswith("-"):
            image = word
            break
    assert next(rest, None) is None, "the image's own command is run"
    environment = dict(one.split("=", 1) for one in options["-e"])
    return Deployment(image, environment, tuple(one.split(":")[1] for one in options["-v"]))


def runs(text: str) -> list[str]:
    """Commands of a text that run the service's container."""
    joined = re.sub(r"\\\n(# )?\s*", "", text)
    found = re.findall(r"^(?:#  *)?(docker run .*)$", joined, re.MULTILINE)
    return [command for command in found if "--entrypoint" not in command]


def compose() -> Deployment:
    service = documents("compose.yaml")[0]["services"]["service"]
    return Deployment(service["image"], service["environment"])


DEPLOYMENTS: dict[str, Deployment] = {
    "kubernetes": of_pod(documents(BASE)[0]["spec"]["template"]["spec"]),
    "kserve": of_pod(documents("kubernetes/kserve.yaml")[0]["spec"]),
    "compose": compose(),
    **{
        f"{name} {index}": of_command(command)
        for name, text in {"Dockerfile": DOCKERFILE, "guide": GUIDE.read_text("utf-8")}.items()
        for index, command in enumerate(runs(text))
    },
}


def instruction(name: str) -> list[str]:
    """The command of an instruction of the Dockerfile; python is that of the service."""
    (words,) = re.findall(rf"^{name} .*?(\[.*\])$", DOCKERFILE.replace("\\\n", ""), re.MULTILINE)
    return [str(SERVICE_PYTHON) if word == "python" else word for word in json.loads(words)]


def kubernetes() -> dict[str, str]:
    """Variables that Kubernetes sets in every pod beside the manifests' Services."""
    set_by_it = {"KUBERNETES_SERVICE_HOST": "10.96.0.1", "KUBERNETES_PORT": "tcp://10.96.0.1:443"}
    services = [one for one in documents(BASE) if one["kind"] == "Service"]
    named = {one["metadata"]["name"]: one["spec"]["ports"] for one in services}
    for name, (port,) in {**named, "rollcast-canary": services[0]["spec"]["ports"]}.items():
        prefix = name.upper().replace("-", "_")
        number, address = port["port"], "10.96.7.7"
        url = f"tcp://{address}:{number}"
        set_by_it |= {
            f"{prefix}_SERVICE_HOST": address,
            f"{prefix}_SERVICE_PORT": str(number),
            f"{prefix}_SERVICE_PORT_{port['name'].upper()}": str(number),
            f"{prefix}_PORT": url,
            f"{prefix}_PORT_{number}_TCP": url,
            f"{prefix}_PORT_{number}_TCP_PROTO": "tcp",
            f"{prefix}_PORT_{number}_TCP_PORT": str(number),
            f"{prefix}_PORT_{number}_TCP_ADDR": address,
        }
    return set_by_it


@pytest.fixture(scope="module")
def secret(tmp_path_factory) -> tuple[Path, str]:
    """A folder with a file of keys, laid out as Kubernetes does, and its key."""
    folder = tmp_path_factory.mktemp("secret")
    (folder / "..2027").mkdir()
    (folder / "..data").symlink_to("..2027")
    add = ("-m", "service.auth", "--file", folder / "..2027/keys.json", "add", "robot")
    made = subprocess.run(
        [SERVICE_PYTHON, *add], capture_output=True, text=True, check=True, cwd=ROOT
    )
    (folder / "keys.json").symlink_to("..data/keys.json")
    return folder, made.stdout.strip()


@pytest.fixture(scope="module")
def models(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("models")
    shutil.copytree(ROOT / "models/posnet", folder / "posnet")
    return folder


def assert_it_serves(deployment: Deployment, secret: tuple[Path, str], models: Path) -> None:
    folder, key = secret
    given = dict(deployment.environment)
    if (path := given.get("ROLLCAST_KEYS_FILE")) is not None:
        assert path.startswith(deployment.mounts)
        given["ROLLCAST_KEYS_FILE"] = str(folder / Path(path).name)
    environment = {
        "PATH": "/usr/bin:/bin",
        "HOME": "/tmp",
        "ROLLCAST_MODELS_DIR": str(models),
        **kubernetes(),
        **dict.fromkeys(PROXIES, "http://127.0.0.1:9"),
        **given,
    }
    command = [*instruction("ENTRYPOINT"), *instruction("CMD")]
    world = World(command, instruction("HEALTHCHECK"), environment, key)
    seen = in_container(world, str(ROOT))
    assert seen.healthy, seen.said
    asks_for_keys = "ROLLCAST_KEYS_FILE" in given
    assert (seen.without_key, seen.with_key) == (401 if asks_for_keys else 200, 200)
    assert seen.stopped in {0, -15}, seen.said


needs_namespaces = pytest.mark.skipif(
    subprocess.run(
        ["unshare", "--user", "--map-root-user", "--net", "true"], capture_output=True, check=False
    ).returncode
    != 0,
    reason="this machine allows no user namespaces",
)


@needs_namespaces
@pytest.mark.parametrize("name", DEPLOYMENTS)
def test_it_serves_in_the_world_that_it_is_for(name, secret, models):
    assert_it_serves(DEPLOYMENTS[name], secret, models)


@needs_namespaces
@pytest.mark.parametrize("host", ["127.0.0.1", "0.0.0.0"])
def test_what_serve_prints_outside_a_checkout_serves(host, secret, models, tmp_path):
    package = Path(rollcast.__file__).parent
    shutil.copytree(package, tmp_path / "rollcast", ignore=shutil.ignore_patterns("__pycache__"))
    told = subprocess.run(
        [sys.executable, "-m", "rollcast", "serve", "--host", host],
        capture_output=True, cwd=tmp_path, text=True, check=False,
    )  # fmt: skip
    deployment = of_command(told.stdout.strip())
    assert_it_serves(deployment, secret, models)
    reached_by_others = host == "0.0.0.0"
    assert ("ROLLCAST_KEYS_FILE" in deployment.environment) == reached_by_others
    assert deployment.image in documented_images()


def documented_images() -> set[str]:
    return set(re.findall(r"docker build .*?-t (\S+)", GUIDE.read_text("utf-8")))


def test_every_image_is_made_by_a_documented_step():
    ray = documents("kubernetes/ray.yaml")[0]["spec"]["rayClusterConfig"]
    groups = (ray["headGroupSpec"], *ray["workerGroupSpecs"])
    ray_images = {group["template"]["spec"]["containers"][0]["image"] for group in groups}
    named = {deployment.image for deployment in DEPLOYMENTS.values()} | ray_images
    assert named == documented_images()
    assert all(image.endswith(f":{VERSION}") for image in named)


needs_kubectl = pytest.mark.skipif(shutil.which("kubectl") is None, reason="there is no kubectl")


def rendered(overlay: str) -> dict[str, Any]:
    """What an overlay makes of the base, by kind."""
    folder = DOCKER / "kubernetes/overlays" / overlay
    done = subprocess.run(["kubectl", "kustomize", folder], capture_output=True, check=True)
    return {one["kind"]: one for one in yaml.safe_load_all(done.stdout)}


def pod_of(kinds: dict[str, Any]) -> Any:
    return kinds["Deployment"]["spec"]["template"]["spec"]


@needs_kubectl
def test_overlays_give_the_service_what_the_base_gives():
    base, local, production = (
        DEPLOYMENTS["kubernetes"],
        *(of_pod(pod_of(rendered(overlay))) for overlay in OVERLAYS),
    )
    assert local == base
    assert (production.environment, production.mounts) == (base.environment, base.mounts)
    assert re.fullmatch(r"registry\.example/rollcast-service@sha256:[0-9a-f]{64}", production.image)


@needs_kubectl
@pytest.mark.parametrize("overlay", OVERLAYS)
def test_every_object_of_a_cluster_means_the_same_pods(overlay):
    kinds = rendered(overlay)
    deployment = kinds["Deployment"]["spec"]
    labels = deployment["template"]["metadata"]["labels"].items()
    (container,) = pod_of(kinds)["containers"]
    ports = {port["name"] for port in container["ports"]}
    (service_port,) = kinds["Service"]["spec"]["ports"]
    policy = kinds["NetworkPolicy"]["spec"]
    assert deployment["selector"]["matchLabels"].items() <= labels
    assert kinds["Service"]["spec"]["selector"].items() <= labels
    assert policy["podSelector"]["matchLabels"].items() <= labels
    (let_in,) = policy["ingress"]
    assert {port["port"] for port in let_in["ports"]} == ports == {service_port["targetPort"]}
    probes = [container[f"{name}Probe"] for name in ("startup", "readiness", "liveness")]
    assert {probe["httpGet"]["port"] for probe in probes} == ports
    if overlay == "local":
        assert kinds.keys().isdisjoint({"PodDisruptionBudget", "HorizontalPodAutoscaler"})
        return
    budget, scaler = (
        kinds[name]["spec"] for name in ("PodDisruptionBudget", "HorizontalPodAutoscaler")
    )
    assert budget["selector"]["matchLabels"].items() <= labels
    assert budget["minAvailable"] < scaler["minReplicas"], "a node can be drained"
    assert scaler["scaleTargetRef"]["name"] == kinds["Deployment"]["metadata"]["name"]
    monitor = kinds["ServiceMonitor"]["spec"]
    assert (
        monitor["selector"]["matchLabels"].items() <= kinds["Service"]["metadata"]["labels"].items()
    )
    assert [one["port"] for one in monitor["endpoints"]] == [service_port["name"]]


@pytest.mark.parametrize("name", ["kubernetes/base/rollcast.yaml", "kubernetes/kserve.yaml"])
def test_one_slow_answer_takes_no_replica_out(name):
    spec = documents(name)[0]["spec"]
    spec = spec["template"]["spec"] if "template" in spec else spec
    (container,) = spec["containers"]
    probe = container["readinessProbe"]
    assert probe["failureThreshold"] > 1
    assert probe["timeoutSeconds"] >= 2
    # A replica that stops goes on listening until its probe, too, has taken it out.
    environment = {one["name"]: one.get("value") for one in container["env"]}
    delay_s = int(environment["ROLLCAST_SHUTDOWN_DELAY_S"])
    assert delay_s > probe["periodSeconds"] * probe["failureThreshold"]
    if "terminationGracePeriodSeconds" in spec:
        accepted_s, exit_s = 30, 3  # by default, as the guide has it
        assert spec["terminationGracePeriodSeconds"] > delay_s + accepted_s + exit_s


def test_every_secret_and_folder_is_made_or_there():
    guide = GUIDE.read_text("utf-8")
    made = set(re.findall(r"kubectl create secret generic (\S+)", guide))
    pod = documents(BASE)[0]["spec"]["template"]["spec"]
    named = {one["secret"]["secretName"] for one in pod["volumes"] if "secret" in one}
    (monitor,) = documents("kubernetes/overlays/production/service-monitor.yaml")
    named |= {one["authorization"]["credentials"]["name"] for one in monitor["spec"]["endpoints"]}
    assert named == made
    applied = re.findall(r"kubectl apply -[kf] (\S+)", guide)
    assert {Path(path).name for path in applied} >= set(OVERLAYS)
    assert all((ROOT / path).exists() for path in applied)


def test_no_manifest_chooses_a_user():
    """OpenShift gives every project users of its own; elsewhere it is the image's, a number."""
    for path in sorted((DOCKER / "kubernetes").rglob("*.yaml")):
        if "containers:" not in path.read_text("utf-8"):
            continue
        text = path.read_text("utf-8")
        assert "runAsNonRoot: true" in text or "overlays" in path.parts
        assert not re.search("runAsUser|runAsGroup|fsGroup", text), path
    assert re.search(r"^USER \d+:\d+$", DOCKERFILE, re.MULTILINE)


def test_every_file_of_docker_can_be_read():
    for path in DOCKER.rglob("*"):
        if path.suffix in {".yaml", ".json"}:
            assert all(yaml.safe_load_all(path.read_text("utf-8")))
