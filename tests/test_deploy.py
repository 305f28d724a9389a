"""What is under deploy/ is what it says: manifests that Kubernetes takes, names that exist, numbers that fit."""

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

DEPLOY = ROOT / "deploy"
OVERLAYS = ("baked", "volume", "s3")
OF_THE_OPERATOR = {"ServiceMonitor", "PrometheusRule"}  # not Kubernetes's own, so not in its schemas
KUBERNETES = ("1.30", "1.37")  # the oldest that is meant to work, and the newest that the validator knows
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
    """What an overlay installs, by kind, built by Kubernetes's own tool."""
    found = list(yaml.safe_load_all(_built(overlay)))
    by_kind = {document["kind"]: document for document in found}
    assert len(by_kind) == len(found)
    return by_kind


def pod(overlay: str) -> Any:
    """The pod of an overlay."""
    return manifests(overlay)["Deployment"]["spec"]["template"]["spec"]


def environment(overlay: str) -> dict[str, str]:
    """The environment of its container."""
    return {entry["name"]: entry["value"] for entry in pod(overlay)["containers"][0]["env"]}


each_overlay = pytest.mark.parametrize("overlay", OVERLAYS)


@each_overlay
@pytest.mark.parametrize("release", KUBERNETES)
def test_kubernetes_would_take_every_manifest(overlay: str, release: str) -> None:
    """Against its own schemas, unknown fields refused."""
    for kind, document in manifests(overlay).items():
        if kind not in OF_THE_OPERATOR:
            kubernetes_validate.validate(document, release, strict=True)


def test_the_validator_would_notice() -> None:
    """A field that is misspelt, one of the wrong type."""
    deployment = manifests("baked")["Deployment"]
    for change in ({"replica": 2}, {"replicas": "two"}):
        wrong = copy.deepcopy(deployment)
        wrong["spec"] |= change
        with pytest.raises(kubernetes_validate.ValidationError):
            kubernetes_validate.validate(wrong, KUBERNETES[-1], strict=True)


@each_overlay
def test_an_overlay_installs_everything(overlay: str) -> None:
    """Nothing got lost on the way from the base."""
    expected = {
        *("ServiceAccount", "Deployment", "Service", "PodDisruptionBudget"),
        *("HorizontalPodAutoscaler", "NetworkPolicy", *OF_THE_OPERATOR),
    }
    assert set(manifests(overlay)) - {"PersistentVolumeClaim"} == expected


@each_overlay
def test_the_container_may_do_nothing_that_it_need_not(overlay: str) -> None:
    """Nobody in particular, a read-only root, no capability, the runtime's system calls only, no token."""
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
def test_probes_ask_routes_that_exist_on_the_port_that_is_listened_on(overlay: str) -> None:
    """Alive is not ready: a registry that is gone must not restart what serves."""
    container = pod(overlay)["containers"][0]
    ports = {port["name"]: port["containerPort"] for port in container["ports"]}
    assert ports["metrics"] == int(environment(overlay)["CAZSL_METRICS_PORT"])
    assert f"CAZSL_PORT={ports['http']}" in (ROOT / "Dockerfile").read_text(encoding="utf-8")
    paths = {name: container[name]["httpGet"]["path"] for name in ("startupProbe", "livenessProbe", "readinessProbe")}
    assert paths == {"startupProbe": "/livez", "livenessProbe": "/livez", "readinessProbe": "/readyz"}
    documented = json.loads((ROOT / "openapi" / "openapi.json").read_text(encoding="utf-8"))["paths"]
    assert set(paths.values()) <= set(documented)


@each_overlay
def test_what_is_set_are_settings_and_time_enough_to_end_well(overlay: str) -> None:
    """An unknown name would stop the start; what is killed while it drains loses requests."""
    values = {name.removeprefix(PREFIX).lower(): value for name, value in environment(overlay).items()}
    assert set(values) <= set(Settings.model_fields)
    assert Settings(**values)  # type: ignore[arg-type]  # texts, as the environment has them
    found = pod(overlay)
    assert found["enableServiceLinks"] is False, "Kubernetes would set CAZSL_PORT to something else"
    readiness = found["containers"][0]["readinessProbe"]
    notices_s = readiness["periodSeconds"] * readiness["failureThreshold"] + readiness["timeoutSeconds"]
    assert float(values["drain_s"]) > notices_s
    assert found["terminationGracePeriodSeconds"] > float(values["drain_s"]) + float(values["grace_s"])


@each_overlay
def test_everything_selects_the_pods_that_there_are(overlay: str) -> None:
    """A selector that fits nothing is taken without a word."""
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
    assert found["Service"]["metadata"]["labels"][monitor["jobLabel"]] == "cazsl"  # what the alerts look for
    ports = {port["name"]: port["targetPort"] for port in found["Service"]["spec"]["ports"]}
    assert {endpoint["port"] for endpoint in monitor["endpoints"]} <= set(ports)
    assert set(ports.values()) == {port["name"] for port in pod(overlay)["containers"][0]["ports"]}


def test_each_overlay_has_its_registry() -> None:
    """Baked in, mounted where the image looks and read-only, or in a bucket that may be asked."""
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
    """Of no other, and never of whatever is newest."""
    images = {overlay: pod(overlay)["containers"][0]["image"] for overlay in OVERLAYS}
    version = f"cazsl:{service.__version__}"
    assert images == {"baked": version, "volume": version, "s3": f"{version}-s3"}
    assert COMPOSE["services"]["cazsl"]["image"] == version


def test_compose_takes_its_file() -> None:
    """Against the schema of the Compose specification."""
    command = [str(BIN / "check-jsonschema"), "--builtin-schema", "vendor.compose-spec", str(DEPLOY / "compose.yaml")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


def test_compose_is_as_careful_as_kubernetes() -> None:
    """The same limits on what the container may do, and time enough to end well."""
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
    """Every expression of the alerts and the dashboard, Grafana's variables filled in."""
    for rule in ALERTS["groups"][0]["rules"]:
        yield rule["alert"], rule["expr"]
    for panel in DASHBOARD["panels"]:
        for target in panel.get("targets", ()):
            yield panel["title"], target["expr"].replace("$__rate_interval", "5m").replace("$job", "cazsl")


def used(text: str) -> Iterator[tuple[str, set[str]]]:
    """Every metric of an expression, with the labels that are matched."""
    waiting: list[Any] = [promql_parser.parse(text)]
    while waiting:
        node = waiting.pop()
        if isinstance(node, promql_parser.VectorSelector):
            yield node.name or "", {matcher.name for matcher in node.matchers.matchers}
        children = [getattr(node, name, None) for name in ("lhs", "rhs", "expr", "vector_selector")]
        waiting += [child for child in (*children, *getattr(node, "args", ())) if child is not None]


@pytest.fixture(scope="module")
def exposed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, set[str]]:
    """Every series that the service exposes once everything happened to it, and the labels that it has."""
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
    """A misspelt name is not an error in Prometheus: it is an alert that never comes."""
    metrics = list(used(expression))
    assert metrics, place
    names = {name for name, _ in metrics}
    assert names - {"up"} <= set(exposed), place
    known = {name: exposed.get(name, set()) | LABELS_OF_PROMETHEUS for name in names}
    for name, labels in metrics:
        assert labels <= known[name], (place, name)
    grouped = {label.strip() for group in re.findall(r"\bby \(([^)]*)\)", expression) for label in group.split(",")}
    counted_nothing_yet = {name for name in names - {"up"} if not exposed[name]}
    assert counted_nothing_yet or grouped <= set().union(*known.values()), place


def test_every_metric_of_ours_is_looked_at_somewhere(exposed: dict[str, set[str]]) -> None:
    """What nobody looks at need not be counted."""
    looked_at = {name for _, expression in expressions() for name, _ in used(expression)}
    families = {re.sub(r"_(bucket|count|sum|total|created)$", "", name) for name in exposed}
    ours = {name for name in families if name.startswith("cazsl_")}
    assert ours <= {re.sub(r"_(bucket|count|sum|total)$", "", name) for name in looked_at}


def test_every_alert_says_what_is_wrong_and_what_to_do() -> None:
    """And whom it may wake."""
    for rule in ALERTS["groups"][0]["rules"]:
        assert set(rule) == {"alert", "expr", "for", "labels", "annotations"}
        assert rule["labels"]["severity"] in ("page", "ticket")
        assert set(rule["annotations"]) == {"summary", "action"}


def test_the_operator_has_the_same_alerts() -> None:
    """One set of rules, in two wrappings."""
    assert manifests("baked")["PrometheusRule"]["spec"]["groups"] == ALERTS["groups"]


def test_the_dashboards_panels_stand_beside_each_other() -> None:
    """Each with a number of its own; none upon another."""
    taken: set[tuple[int, int]] = set()
    for panel in DASHBOARD["panels"]:
        place = panel["gridPos"]
        cells = {(place["x"] + right, place["y"] + down) for right in range(place["w"]) for down in range(place["h"])}
        assert not cells & taken, panel["title"]
        assert place["x"] + place["w"] <= 24
        taken |= cells
    assert len({panel["id"] for panel in DASHBOARD["panels"]}) == len(DASHBOARD["panels"])


@pytest.mark.parametrize(("lock", "extras"), [("serving", ()), ("s3", ("s3",)), ("all", ("s3", "signing", "otel"))])
def test_the_image_holds_versions_that_fit_what_is_declared(lock: str, extras: tuple[str, ...]) -> None:
    """``make lock`` was run after the last change of dependencies; each version has its digests."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    text = (DEPLOY / "locks" / f"{lock}.txt").read_text(encoding="utf-8")
    lines = re.findall(r"^([a-z0-9-]+)==([^ ;\\]+).*?(\\\n +--hash=sha256:|$)", text, re.MULTILINE)
    assert all(digests.strip() for _, _, digests in lines)
    pinned = {name: version for name, version, _ in lines}
    declared = [
        *project["dependencies"],
        *(entry for extra in extras for entry in project["optional-dependencies"][extra]),
    ]
    for wanted in map(Requirement, declared):
        assert pinned[wanted.name] in wanted.specifier, wanted
