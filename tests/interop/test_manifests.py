"""What starts several programs that share jobs, by the schemas of those who read it: Kubernetes and Compose."""

import json
import pathlib

import kubernetes_validate
import pytest
import yaml
from compose_spec import PyCompose

DEPLOY = pathlib.Path(__file__).resolve().parents[2] / "deploy"
VERSIONS = ["1.34", "1.35", "1.36", "1.37"]


def manifests():
    """Those of Kubernetes' own kinds; KEDA's have no schema there."""
    fleet = [path for path in (DEPLOY / "kubernetes").iterdir() if path.name != "kustomization.yaml"]
    files = sorted([*fleet, DEPLOY / "batch" / "kubernetes.yaml"])
    all_of_them = [value for path in files for value in yaml.safe_load_all(path.read_text())]
    return [value for value in all_of_them if not value["apiVersion"].startswith("keda.sh/")]


def check_manifest(value, version):
    kubernetes_validate.validate(value, version, strict=True)


def check_compose(value):
    PyCompose.from_json(json.dumps(value)).validate()


@pytest.mark.parametrize("version", VERSIONS)
def test_manifests_are_what_kubernetes_takes(version):
    all_of_them = manifests()
    assert len(all_of_them) > 12
    for value in all_of_them:
        check_manifest(value, version)


def test_the_compose_file_is_what_compose_takes():
    check_compose(yaml.safe_load((DEPLOY / "compose.yaml").read_text()))


def test_a_misspelt_field_is_found():
    worker = next(value for value in manifests() if value["kind"] == "Deployment")
    worker["spec"]["template"]["spec"]["terminationGracePeriod"] = 45
    with pytest.raises(kubernetes_validate.ValidationError):
        check_manifest(worker, VERSIONS[-1])
    compose = yaml.safe_load((DEPLOY / "compose.yaml").read_text())
    compose["services"]["worker"]["comand"] = ["worker"]
    with pytest.raises(ValueError, match="comand"):
        check_compose(compose)
