"""The files of deploy/: manifests are valid, the names in them exist, and their numbers agree."""

import copy
import json
import re
import subprocess
import sys
import tomllib
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import kubernetes_validate
import promql_parser
import pytest
import yaml
from fastapi.testclient import TestClient
from packaging.requirements import Requirement
from prometheus_client.parser import text_string_to_metric_families

import service
from service.app import create_app
from service.settings import PREFIX, Settings
from tests.conftest import ROOT
from tests.fakes import BROKEN, fake_models, publish_fake
from tests.running_service import serve_in_thread

DEPLOY = ROOT / "deploy"
OVERLAYS = ("baked", "volume", "s3")
OF_THE_OPERATOR = {"ServiceMonitor", "PrometheusRule"}  # not in the schemas of Kubernetes
KUBERNETES = ("1.30", "1.37")  # the oldest supported version, and the newest that the validator knows
LABELS_OF_PROMETHEUS = {"job", "instance", "le", "__name__"}
ALERTS = yaml.safe_load((DEPLOY / "prometheus" / "alerts.yaml").read_text(encoding="utf-8"))
DASHBOARD = json.loads((DEPLOY / "grafana" / "cazsl.json").read_text(encoding="utf-8"))
COMPOSE = yaml.safe_load((DEPLOY / "compose.yaml").read_text(encoding="utf-8"))
BIN = Path(sys.executable).parent


@cache
def _built(overlay: str) -> str:
    command = [str(BIN / "kubectl"), "kustomize", str(DEPLOY / "kubernetes" / "overlays" / overlay)]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def manifests(overlay: str) -> dict[str, Any]:
    """Build the manifests of an overlay with kubectl. Return them by kind."""
    found = list(yaml.safe_load_all(_built(overlay)))
    by_kind = {document["kind"]: document for document in found}
    assert len(by_kind) == len(found)
    return by_kind


def pod(overlay: str) -> Any:
    """Return the pod of an overlay."""
    return manifests(overlay)["Deployment"]["spec"]["template"]["spec"]


def environment(overlay: str) -> dict[str, str]:
    """Return the environment variables of the container of an overlay."""
    return {entry["name"]: entry["value"] for entry in pod(overlay)["containers"][0]["env"]}


each_overlay = pytest.mark.parametrize("overlay", OVERLAYS)


@each_overlay
@pytest.mark.parametrize("release", KUBERNETES)
def test_every_manifest_is_valid(overlay: str, release: str) -> None:
    """Every manifest is valid under the schemas of Kubernetes, which refuse unknown fields."""
    for kind, document in manifests(overlay).items():
        if kind not in OF_THE_OPERATOR:
            kubernetes_validate.validate(document, release, strict=True)


def test_the_validator_refuses_an_invalid_manifest() -> None:
    """The validator refuses a misspelt field and a field of the wrong type."""
    deployment = manifests("baked")["Deployment"]
    for change in ({"replica": 2}, {"replicas": "two"}):
        wrong = copy.deepcopy(deployment)
        wrong["spec"] |= change
        with pytest.raises(kubernetes_validate.ValidationError):
            kubernetes_validate.validate(wrong, KUBERNETES[-1], strict=True)


@each_overlay
def test_an_overlay_installs_everything(overlay: str) -> None:
    """An overlay installs every kind of its base."""
    expected = {
        *("ServiceAccount", "Deployment", "Service", "PodDisruptionBudget"),
        *("HorizontalPodAutoscaler", "NetworkPolicy", *OF_THE_OPERATOR),
    }
    assert set(manifests(overlay)) - {"PersistentVolumeClaim"} == expected


@each_overlay
def test_the_container_has_no_needless_privilege(overlay: str) -> None:
    """The container has a plain user, a read-only root, no capability, the default system calls and no token."""
    found = pod(overlay)
    assert found["securityContext"]["runAsNonRoot"] is True
    assert found["securityContext"]["runAsUser"] == 10001
    assert found["securityContext"]["seccompProfile"] == {"type": "RuntimeDefault"}
    assert found["automountServiceAccountToken"] is False
    for container in found["containers"]:
        assert container["securityContext"] == {
            "allowPrivilegeEscalation": False,
            "readOnlyRootFilesystem": True,
            "capabilities": {"drop": ["ALL"]},
        }


@each_overlay
def test_probes_request_documented_routes_on_the_port_of_the_service(overlay: str) -> None:
    """Liveness requests /livez, not /readyz, because a missing registry must not restart a service with models."""
    container = pod(overlay)["containers"][0]
    ports = {port["name"]: port["containerPort"] for port in container["ports"]}
    assert ports["metrics"] == int(environment(overlay)["CAZSL_METRICS_PORT"])
    assert f"CAZSL_PORT={ports['http']}" in (ROOT / "Dockerfile").read_text(encoding="utf-8")
    paths = {name: container[name]["httpGet"]["path"] for name in ("startupProbe", "livenessProbe", "readinessProbe")}
    assert paths == {"startupProbe": "/livez", "livenessProbe": "/livez", "readinessProbe": "/readyz"}
    documented = json.loads((ROOT / "openapi" / "openapi.json").read_text(encoding="utf-8"))["paths"]
    assert set(paths.values()) <= set(documented)


@each_overlay
def test_the_environment_holds_known_settings_and_leaves_time_to_drain(overlay: str) -> None:
    """Every variable is a setting, because an unknown one stops the start, and a pod is killed only after its drain."""
    values = {name.removeprefix(PREFIX).lower(): value for name, value in environment(overlay).items()}
    assert set(values) <= set(Settings.model_fields)
    assert Settings(**values)  # type: ignore[arg-type]  # texts, as in the environment
    found = pod(overlay)
    assert found["enableServiceLinks"] is False, "Kubernetes would set CAZSL_PORT to something else"
    readiness = found["containers"][0]["readinessProbe"]
    notices_s = readiness["periodSeconds"] * readiness["failureThreshold"] + readiness["timeoutSeconds"]
    assert float(values["drain_s"]) > notices_s
    assert found["terminationGracePeriodSeconds"] > float(values["drain_s"]) + float(values["grace_s"])


@each_overlay
def test_every_selector_matches_the_pods(overlay: str) -> None:
    """Every selector matches the pods of its overlay. Kubernetes accepts a selector without a match silently."""
    found = manifests(overlay)
    labels = found["Deployment"]["spec"]["template"]["metadata"]["labels"].items()
    assert found["Deployment"]["spec"]["selector"]["matchLabels"].items() <= labels
    assert found["Service"]["spec"]["selector"].items() <= labels
    assert found["PodDisruptionBudget"]["spec"]["selector"]["matchLabels"].items() <= labels
    assert found["NetworkPolicy"]["spec"]["podSelector"]["matchLabels"].items() <= labels
    target = found["HorizontalPodAutoscaler"]["spec"]["scaleTargetRef"]
    assert (target["kind"], target["name"]) == ("Deployment", found["Deployment"]["metadata"]["name"])
    monitor = found["ServiceMonitor"]["spec"]
    assert monitor["selector"]["matchLabels"].items() <= found["Service"]["metadata"]["labels"].items()
    assert found["Service"]["metadata"]["labels"][monitor["jobLabel"]] == "cazsl"  # the job label of the alerts
    ports = {port["name"]: port["targetPort"] for port in found["Service"]["spec"]["ports"]}
    assert {endpoint["port"] for endpoint in monitor["endpoints"]} <= set(ports)
    assert set(ports.values()) == {port["name"] for port in pod(overlay)["containers"][0]["ports"]}


def test_each_overlay_has_its_registry() -> None:
    """The registry is in the image, or mounted read-only where the image expects it, or in a bucket within reach."""
    assert "CAZSL_REGISTRY" not in environment("baked")
    assert "volumes" not in pod("baked")
    assert manifests("baked")["NetworkPolicy"]["spec"]["egress"] == []
    [mount] = pod("volume")["containers"][0]["volumeMounts"]
    assert (mount["mountPath"], mount["readOnly"]) == ("/srv/models", True)
    claim = pod("volume")["volumes"][0]["persistentVolumeClaim"]["claimName"]
    assert claim == manifests("volume")["PersistentVolumeClaim"]["metadata"]["name"]
    assert environment("s3")["CAZSL_REGISTRY"].startswith("s3://")
    assert environment("s3")["CAZSL_CACHE"] == pod("s3")["containers"][0]["volumeMounts"][0]["mountPath"]
    open_ports = {port["port"] for rule in manifests("s3")["NetworkPolicy"]["spec"]["egress"] for port in rule["ports"]}
    assert open_ports == {53, 443}


def test_images_are_of_this_version() -> None:
    """Images carry the version of this code, never a tag such as latest."""
    images = {overlay: pod(overlay)["containers"][0]["image"] for overlay in OVERLAYS}
    version = f"cazsl:{service.__version__}"
    assert images == {"baked": version, "volume": version, "s3": f"{version}-s3"}
    assert COMPOSE["services"]["cazsl"]["image"] == version


def test_the_compose_file_is_valid() -> None:
    """The Compose file is valid under the schema of the Compose specification."""
    command = [str(BIN / "check-jsonschema"), "--builtin-schema", "vendor.compose-spec", str(DEPLOY / "compose.yaml")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


def test_compose_restricts_the_container_as_kubernetes_does() -> None:
    """Under Compose the container has the same restrictions as under Kubernetes, and time to drain."""
    found = COMPOSE["services"]["cazsl"]
    assert found["read_only"] is True
    assert found["cap_drop"] == ["ALL"]
    assert found["user"] == "10001:10001"
    values = {name.removeprefix(PREFIX).lower(): value for name, value in found["environment"].items()}
    settings = Settings(**values)
    assert float(found["stop_grace_period"].removesuffix("s")) > settings.drain_s + settings.grace_s
    for name in COMPOSE["services"]:
        for volume in COMPOSE["services"][name].get("volumes", ()):
            assert (DEPLOY / volume.split(":")[0]).exists(), volume


def expressions() -> Iterator[tuple[str, str]]:
    """Yield every expression of the alerts and the dashboard with its title. Grafana's variables are filled in."""
    for rule in ALERTS["groups"][0]["rules"]:
        yield rule["alert"], rule["expr"]
    for panel in DASHBOARD["panels"]:
        for target in panel.get("targets", ()):
            yield panel["title"], target["expr"].replace("$__rate_interval", "5m").replace("$job", "cazsl")


def used(text: str) -> Iterator[tuple[str, set[str]]]:
    """Yield every metric of an expression, with the labels of its matchers."""
    waiting: list[Any] = [promql_parser.parse(text)]
    while waiting:
        node = waiting.pop()
        if isinstance(node, promql_parser.VectorSelector):
            yield node.name or "", {matcher.name for matcher in node.matchers.matchers}
        children = [getattr(node, name, None) for name in ("lhs", "rhs", "expr", "vector_selector")]
        waiting += [child for child in (*children, *getattr(node, "args", ())) if child is not None]


@pytest.fixture(scope="module")
def exposed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, set[str]]:
    """Return every series of a service with a prediction, a refusal and a broken version, and the labels of each."""
    registry, models = fake_models(tmp_path_factory.mktemp("metrics") / "models")
    publish_fake(registry)
    publish_fake(registry, "push-visual", model=BROKEN)
    models.refresh()
    app = create_app(Settings(poll_interval_s=3600), models)
    with TestClient(app) as client:
        body = {"pusher": {"x": 0.0, "y": 0.0, "angle": 0.0}, "context": {"descriptor": "1a2b3c4a"}}
        assert client.post("/v1/predict", json=body).status_code == 200
        assert client.post("/v1/predict", json={}).status_code == 422
        text = client.get("/metrics").text
    found: dict[str, set[str]] = defaultdict(set)
    for family in text_string_to_metric_families(text):
        found[f"{family.name}_total" if family.type == "counter" else family.name] |= set()
        for sample in family.samples:
            found[sample.name] |= set(sample.labels)
    return dict(found)


@pytest.mark.parametrize(("place", "expression"), list(expressions()))
def test_every_expression_reads_metrics_and_labels_that_exist(
    exposed: dict[str, set[str]], place: str, expression: str
) -> None:
    """Every expression reads existing metrics and labels. In Prometheus a misspelt name is no error, but no alert."""
    metrics = list(used(expression))
    assert metrics, place
    names = {name for name, _ in metrics}
    assert names - {"up"} <= set(exposed), place
    known = {name: exposed.get(name, set()) | LABELS_OF_PROMETHEUS for name in names}
    for name, labels in metrics:
        assert labels <= known[name], (place, name)
    grouped = {label.strip() for group in re.findall(r"\bby \(([^)]*)\)", expression) for label in group.split(",")}
    without_samples = {name for name in names - {"up"} if not exposed[name]}
    assert without_samples or grouped <= set().union(*known.values()), place


def test_every_metric_of_the_service_is_in_an_expression(exposed: dict[str, set[str]]) -> None:
    """Every metric of the service is used by an alert or the dashboard. An unused metric should not be counted."""
    read = {name for _, expression in expressions() for name, _ in used(expression)}
    families = {re.sub(r"_(bucket|count|sum|total|created)$", "", name) for name in exposed}
    ours = {name for name in families if name.startswith("cazsl_")}
    assert ours <= {re.sub(r"_(bucket|count|sum|total)$", "", name) for name in read}


def test_every_alert_has_a_summary_an_action_and_a_severity() -> None:
    """Every alert has a summary, an action, and a severity: page or ticket."""
    for rule in ALERTS["groups"][0]["rules"]:
        assert set(rule) == {"alert", "expr", "for", "labels", "annotations"}
        assert rule["labels"]["severity"] in ("page", "ticket")
        assert set(rule["annotations"]) == {"summary", "action"}


def test_the_operator_has_the_same_alerts() -> None:
    """The PrometheusRule of the operator has the alerts of prometheus/alerts.yaml."""
    assert manifests("baked")["PrometheusRule"]["spec"]["groups"] == ALERTS["groups"]


def test_the_panels_of_the_dashboard_do_not_overlap() -> None:
    """The panels of the dashboard do not overlap, fit the width of the grid, and have ids of their own."""
    taken: set[tuple[int, int]] = set()
    for panel in DASHBOARD["panels"]:
        place = panel["gridPos"]
        cells = {(place["x"] + right, place["y"] + down) for right in range(place["w"]) for down in range(place["h"])}
        assert not cells & taken, panel["title"]
        assert place["x"] + place["w"] <= 24
        taken |= cells
    assert len({panel["id"] for panel in DASHBOARD["panels"]}) == len(DASHBOARD["panels"])


@pytest.mark.parametrize(("lock", "extras"), [("serving", ()), ("s3", ("s3",)), ("all", ("s3", "signing", "otel"))])
def test_the_locks_agree_with_the_declared_dependencies(lock: str, extras: tuple[str, ...]) -> None:
    """Each locked version has its digests and satisfies the declared dependency. ``make lock`` renews the locks."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    declared = [
        *project["dependencies"],
        *(entry for extra in extras for entry in project["optional-dependencies"][extra]),
    ]
    check_lock(lock, declared)


def test_the_lock_of_the_build_agrees_with_the_declared_backend() -> None:
    """The backend that builds the wheel in the image is locked with its digests, as every dependency is."""
    check_lock(
        "build", tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["build-system"]["requires"]
    )
    dockerfile = (ROOT / "Dockerfile").read_text(encoding="utf-8")
    installs = re.findall(r"pip --python \S+ install (.*?)(?: \\\\)?$", dockerfile, re.MULTILINE)
    assert len(installs) == 3
    assert all("--require-hashes" in words or "--no-index" in words for words in installs)


def check_lock(lock: str, declared: list[str]) -> None:
    """Check that each version of a lock has its digests, and that the declared requirements are satisfied."""
    text = (DEPLOY / "locks" / f"{lock}.txt").read_text(encoding="utf-8")
    lines = re.findall(r"^([a-z0-9-]+)==([^ ;\\]+).*?(\\\n +--hash=sha256:|$)", text, re.MULTILINE)
    assert all(digests.strip() for _, _, digests in lines)
    pinned = {name: version for name, version, _ in lines}
    for wanted in map(Requirement, declared):
        assert pinned[wanted.name] in wanted.specifier, wanted


@pytest.mark.parametrize("variables", [{"http_proxy": "http://127.0.0.1:9"}, {"CAZSL_PORT": " "}, {}])
def test_the_health_check_of_the_image_asks_the_service_itself(tmp_path: Path, variables: dict[str, str]) -> None:
    """The health check asks the port of the service, or the default one, and no proxy of the environment."""
    dockerfile = (ROOT / "Dockerfile").read_text(encoding="utf-8")
    [check] = re.findall(r"HEALTHCHECK .*\\\n  CMD (\[.*\])", dockerfile)
    program, *words = json.loads(check)
    assert program == "python"
    assert "8000" in check
    registry, models = fake_models(tmp_path / "models")
    publish_fake(registry)
    models.refresh()
    with serve_in_thread(models) as client:
        values = {"CAZSL_PORT": str(client.base_url.port)} | variables
        words[-1] = words[-1].replace("8000", str(client.base_url.port))
        done = subprocess.run([sys.executable, *words], env=values, capture_output=True, check=False)
    assert done.returncode == 0, done.stderr
