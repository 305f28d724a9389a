"""Tests of the causes of failures of a store: each names its cause and its cure, and repeats no text of the store."""

import contextlib
import ssl
import subprocess
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from click.testing import CliRunner

from service.cli.main import main
from service.errors import RegistryError
from service.inference.loaded_models import LoadedModels
from service.registry.location import open_registry
from service.storage.bucket_causes import cause_of
from tests.fakes import load_fake
from tests.s3_server import CREDENTIALS

SECRET = "a text of the store"  # noqa: S105
ANSWERS = {
    (403, "SignatureDoesNotMatch"): "the signature is wrong; check AWS_SECRET_ACCESS_KEY",
    (403, "InvalidAccessKeyId"): "the store does not know this key; check AWS_ACCESS_KEY_ID",
    (403, "AccessDenied"): "permission denied; the key needs the rights",
    (403, "RequestTimeTooSkewed"): "the clock of this machine differs",
    (403, "Odd"): "permission denied; check the keys",
    (400, "ExpiredToken"): "the credentials have expired",
    (400, "InvalidToken"): "check AWS_SESSION_TOKEN",
    (400, "AuthorizationHeaderMalformed"): "another region; set AWS_REGION",
    (401, ""): "the credentials are refused",
    (404, "NoSuchBucket"): "there is no such bucket; check CAZSL_REGISTRY",
    (404, ""): "answers 404 without saying that an object is missing",
    (301, "PermanentRedirect"): "another region; set AWS_REGION",
    (503, "SlowDown"): "it is overloaded; try again later",
    (418, "Odd"): "refused the request with status 418",
}
ENVIRONMENTS = {
    "AWS_ACCESS_KEY_ID has a line break": {"AWS_ACCESS_KEY_ID": "test\n"},
    "AWS_SECRET_ACCESS_KEY has a line break": {"AWS_SECRET_ACCESS_KEY": "te\nst"},
    "AWS_SESSION_TOKEN has a line break": {"AWS_SESSION_TOKEN": "\x07"},
    "AWS_REGION has a line break": {"AWS_REGION": "eu\n"},
    "AWS_REGION has": {"AWS_REGION": "é"},
    "AWS_ENDPOINT_URL is not an address": {"AWS_ENDPOINT_URL": "nonsense"},
    "AWS_ENDPOINT_URL is not an": {"AWS_ENDPOINT_URL": "http://[broken"},
    "AWS_ENDPOINT_URL is not": {"AWS_ENDPOINT_URL": "http://127.0.0.1:99999"},
    "AWS_ENDPOINT_URL is": {"AWS_ENDPOINT_URL": "http://[12345::]"},
    "AWS_ENDPOINT_URL": {"AWS_ENDPOINT_URL": "http://256.256.256.256"},
    "AWS_REGION is not a region": {"AWS_REGION": "a;b"},
    "AWS_DEFAULT_REGION is not a region": {"AWS_DEFAULT_REGION": "a%41"},
    "AWS_ENDPOINT_URL_S3 is not an address": {"AWS_ENDPOINT_URL_S3": "ftp://127.0.0.1"},
    "AWS_SECRET_ACCESS_KEY is not set, but AWS_ACCESS_KEY_ID is": {"AWS_SECRET_ACCESS_KEY": ""},
    "AWS_ACCESS_KEY_ID is not set, but AWS_SECRET_ACCESS_KEY is": {"AWS_ACCESS_KEY_ID": ""},
    "AWS_ACCESS_KEY_ID is empty": {"AWS_ACCESS_KEY_ID": "", "AWS_SECRET_ACCESS_KEY": ""},
    "the name of its host is not known": {"AWS_ENDPOINT_URL": "http://no-such-host.invalid"},
    "the connection is refused": {"AWS_ENDPOINT_URL": "http://127.0.0.1:1"},
}


class Store(BaseHTTPRequestHandler):
    """A store that gives one answer to each request: a status and an error code."""

    answer: tuple[int, str] = (403, "AccessDenied")

    def do_GET(self) -> None:
        """Send the answer."""
        status, code = self.answer
        body = f"<Error><Code>{code}</Code><Message>{SECRET}</Message></Error>".encode() if code else SECRET.encode()
        self.send_response(status)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)

    do_PUT = do_HEAD = do_DELETE = do_POST = do_GET  # noqa: N815 (the names of the library)

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002 (the name of the library)
        """Log no request."""


@contextlib.contextmanager
def serving(certificate: Path | None = None) -> Iterator[str]:
    """Run the store, with TLS if there is a certificate, and return its address."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), Store)
    if certificate is not None:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(certificate)
        server.socket = context.wrap_socket(server.socket, server_side=True)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    try:
        yield f"{'http' if certificate is None else 'https'}://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


@pytest.fixture
def environment(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> pytest.MonkeyPatch:
    """Set the environment of a bucket with an empty cache."""
    for name, value in {**CREDENTIALS, "CAZSL_CACHE": str(tmp_path / "cache")}.items():
        monkeypatch.setenv(name, value)
    for name in ("AWS_ENDPOINT_URL", "AWS_ENDPOINT_URL_S3", "AWS_SESSION_TOKEN", "AWS_PROFILE", "AWS_DEFAULT_REGION"):
        monkeypatch.delenv(name, raising=False)
    return monkeypatch


def check_every_way(cause: str) -> None:
    """Check that commands, problems and errors name a cause in one line, without a text of the store."""
    registry = open_registry("s3://models/prefix")
    for ask in (registry.names, registry.fingerprint, lambda: registry.state("push-none"), registry.survey):
        with pytest.raises(RegistryError, match=cause.replace("(", r"\(")) as caught:
            ask()
        assert SECRET not in str(caught.value)
    models = LoadedModels(registry, load_fake)
    models.refresh()
    (problem,) = models.snapshot.problems
    assert cause in problem
    for command in (["list"], ["doctor"], ["verify"], ["show", "push-none"], ["history", "push-none"]):
        result = CliRunner().invoke(main, ["models", *command, "--registry", "s3://models/prefix"])
        assert (result.exit_code, cause in result.stderr, len(result.stderr.splitlines())) == (1, True, 1)
        assert SECRET not in result.stderr


@pytest.mark.parametrize("answer", ANSWERS, ids=lambda answer: f"{answer[0]} {answer[1]}")
def test_answer_of_the_store_names_cause_and_cure(environment: pytest.MonkeyPatch, answer: tuple[int, str]) -> None:
    """Each answer of a store that refuses is named with its cure, by every command, error and problem."""
    environment.setattr(Store, "answer", answer)
    with serving() as address:
        environment.setenv("AWS_ENDPOINT_URL", address)
        check_every_way(ANSWERS[answer])


@pytest.mark.parametrize("cause", ENVIRONMENTS)
def test_environment_names_the_variable(environment: pytest.MonkeyPatch, cause: str) -> None:
    """A variable that the library would panic for, or that leads to no store, is named."""
    for name, value in ENVIRONMENTS[cause].items():
        environment.setenv(name, value)
    check_every_way(cause)


def test_untrusted_certificate_is_named(environment: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A certificate that is not trusted, and a port without TLS, are named."""
    command = "openssl req -x509 -newkey rsa:2048 -keyout key -out cert -days 1 -nodes -subj /CN=localhost"
    subprocess.run(command.split(), cwd=tmp_path, check=True, capture_output=True)
    both = tmp_path / "both"
    both.write_bytes((tmp_path / "cert").read_bytes() + (tmp_path / "key").read_bytes())
    with serving(both) as address:
        environment.setenv("AWS_ENDPOINT_URL", address)
        check_every_way("its TLS certificate is not trusted")
    with serving() as address:
        environment.setenv("AWS_ENDPOINT_URL", address.replace("http", "https"))
        check_every_way("TLS failed")


def test_missing_keys_name_the_variables_and_the_profile(environment: pytest.MonkeyPatch) -> None:
    """Without keys, the library asks the machine for a role. Its refusal names the variables, and a set profile."""
    refusal = Exception("Error performing PUT http://169.254.169.254/latest/api/token - HTTP error")
    assert cause_of(refusal) == "no keys were found: set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY"
    environment.setenv("AWS_PROFILE", "robots")
    assert "AWS_PROFILE is not read: `aws configure export-credentials" in cause_of(refusal)


def test_panic_of_the_library_is_an_error(environment: pytest.MonkeyPatch) -> None:
    """A panic of the library, which is no Exception, is a RegistryError."""
    registry = open_registry("s3://models/prefix")
    panic = type("PanicException", (BaseException,), {"__module__": "pyo3_runtime"})

    def fail(*_: object, **__: object) -> None:
        """Panic as the library does."""
        raise panic("called `Result::unwrap()` on an `Err` value")

    environment.setattr("obstore.list_with_delimiter", fail)
    with pytest.raises(RegistryError, match="the library of the bucket failed"):
        registry.names()
    environment.setattr("obstore.list_with_delimiter", lambda *_, **__: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        registry.names()
