"""Images over HTTP: in a form, alone and as base64."""

import base64
import io
import json
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient
from httpx2 import Response
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

from service.app import create_app
from service.model.tensors import ContextKind
from service.pushing.images import GreyImage, visual_context
from service.settings import Settings
from tests.fakes import fake_models, publish_fake

PUSHER = {"x": 0.1, "y": 0.0, "angle": 0.0}


def picture(side: int = 64, at: int = 32) -> np.ndarray[Any, Any]:
    """Draw a bright square on black."""
    grey = np.zeros((side, side), dtype=np.uint8)
    grey[at - 12 : at + 12, at - 12 : at + 12] = 128
    return grey


def encoded(array: np.ndarray[Any, Any], kind: str = "PNG") -> bytes:
    """Encode an image file."""
    buffer = io.BytesIO()
    Image.fromarray(array).save(buffer, kind)
    return buffer.getvalue()


PNG = encoded(picture())
LEVELS = visual_context(GreyImage.from_array(picture())).levels


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    """Return a client of the application over fake models, with a visual one."""
    registry, models = fake_models(tmp_path_factory.mktemp("models"))
    publish_fake(registry, "push-visual", ContextKind.VISUAL)
    models.refresh()
    app = create_app(Settings(poll_interval_s=3600, max_body_bytes=1 << 20), models)
    with TestClient(app, raise_server_exceptions=False) as found:
        yield found


def upload(client: TestClient, path: str = "/v1/predict/image", image: bytes = PNG, **fields: Any) -> Response:
    """Send a form."""
    texts = {name: value if isinstance(value, str) else json.dumps(value) for name, value in fields.items()}
    return client.post(path, files={"image": ("view.png", image, "image/png")}, data=texts)


def code(response: Response) -> tuple[int, str]:
    """Return status and code of a problem."""
    assert response.headers["content-type"] == "application/problem+json", response.text
    return response.status_code, response.json()["code"]


def test_all_forms_of_an_image_get_the_same_answer(client: TestClient) -> None:
    """An image in a form, an image as base64, and its visual context give the same prediction."""
    made = client.post("/v1/contexts", content=PNG, headers={"Content-Type": "image/png"}).json()
    assert base64.b64decode(made["visual"]) == LEVELS
    image = base64.b64encode(PNG).decode()
    answers = [
        upload(client, pusher=PUSHER).json(),
        client.post("/v1/predict", json={"pusher": PUSHER, "context": {"image": image}}).json(),
        client.post("/v1/predict", json={"pusher": PUSHER, "context": {"visual": made["visual"]}}).json(),
    ]
    assert answers[0] == answers[1] == answers[2]
    assert answers[0]["model"] == {"name": "push-visual", "version": 1}


def test_several_pushes_of_one_image_get_columns(client: TestClient) -> None:
    """Several pushes of the object in an image are answered in columns, in the object frame or in the world."""
    rows = [[0.1, 0.0, 0.0], [0.2, 0.0, 0.0]]
    image = base64.b64encode(PNG).decode()
    many = upload(client, pushers=rows).json()
    assert many == client.post("/v1/predict/batch", json={"pushers": rows, "contexts": [{"image": image}]}).json()
    assert [row[0] for row in many["mean"]] == pytest.approx([-0.01, -0.02])
    assert upload(client, pushers=rows, object_poses=[[0.0, 0.0, 0.0]], model="push-visual").json()["frame"] == "world"
    assert upload(client, pusher=PUSHER, object_pose=PUSHER).json()["frame"] == "world"


@pytest.mark.parametrize("kind", ["PNG", "JPEG", "WEBP"])
def test_an_image_becomes_a_visual_context_with_a_thumbnail(client: TestClient, kind: str) -> None:
    """An image alone and in a form give the same context, and its thumbnail shows the same levels."""
    content = encoded(picture(), kind)
    by_itself = client.post("/v1/contexts", content=content, headers={"Content-Type": f"image/{kind.lower()}"})
    assert by_itself.status_code == 200, by_itself.text
    assert by_itself.json() == upload(client, "/v1/contexts", content).json()
    levels = np.frombuffer(base64.b64decode(by_itself.json()["visual"]), np.uint8).reshape(32, 32)
    with Image.open(io.BytesIO(base64.b64decode(by_itself.json()["thumbnail_png"]))) as thumbnail:
        assert (np.array(thumbnail)[::8, ::8] == levels).all()
    assert by_itself.json()["flags"] == []


def test_faults_of_an_image_are_flagged(client: TestClient) -> None:
    """A blank image and an object at the border have their flags."""
    assert upload(client, "/v1/contexts", encoded(np.zeros((40, 40), np.uint8))).json()["flags"] == ["blank"]
    assert "clipped" in upload(client, "/v1/contexts", encoded(picture(at=12))).json()["flags"]


def test_faults_of_an_upload_name_their_field(client: TestClient) -> None:
    """A missing or faulty field of a form is a problem that names it."""
    assert code(upload(client)) == (422, "invalid_request")
    assert upload(client).json()["errors"][0]["where"] == "body.pusher"
    assert upload(client, pusher={**PUSHER, "x": "0"}).json()["errors"][0]["where"] == "body.pusher.x"
    assert upload(client, pusher="{").json()["errors"][0]["where"] == "body.pusher"
    assert upload(client, pushers=[[0, 0]]).json()["errors"][0]["where"] == "body.pushers.0"
    assert code(upload(client, pusher=PUSHER, speed="1")) == (422, "invalid_request")
    assert code(upload(client, pusher=PUSHER, pushers=[[0, 0, 0]])) == (422, "invalid_request")
    assert code(upload(client, pusher=PUSHER, model="push-indicator")) == (422, "wrong_context_kind")
    assert code(upload(client, pusher=PUSHER, model="push-visual@9")) == (404, "unknown_model")
    assert code(client.post("/v1/predict/image", files={"picture": PNG}))[0] == 422
    assert code(client.post("/v1/predict/image", data={"image": "text"}, files={"x": b""}))[0] == 422


def test_broken_images_are_refused_in_every_form(client: TestClient) -> None:
    """An image of another format, cut short or too large is refused in a form, alone and as base64."""
    for image, expected in (
        (b"GIF89a" + bytes(20), (415, "unsupported_image")),
        (b"", (415, "unsupported_image")),
        (PNG[:-40], (422, "invalid_request")),
        (encoded(np.zeros((1, 8193), np.uint8)), (413, "image_too_large")),
    ):
        responses = [
            upload(client, image=image, pusher=PUSHER),
            upload(client, "/v1/contexts", image),
            client.post("/v1/contexts", content=image, headers={"Content-Type": "image/png"}),
            client.post("/v1/predict", json={"pusher": PUSHER, "context": {"image": base64.b64encode(image).decode()}}),
        ]
        for response in responses:
            status, name = code(response)
            assert status == expected[0], response.text
            assert name in (expected[1], "invalid_image")


def test_a_batch_has_a_maximum_of_images(client: TestClient) -> None:
    """A batch with more than 16 images is refused, and the error names the route that converts them."""
    image = {"image": base64.b64encode(PNG).decode()}
    body = {"pushers": [[0.1, 0.0, 0.0]] * 17, "contexts": [image] * 16, "context_index": [15] * 17}
    assert client.post("/v1/predict/batch", json=body).status_code == 200
    body["contexts"] = [image] * 17
    assert "/v1/contexts" in client.post("/v1/predict/batch", json=body).json()["detail"]


FORM = b'--b\r\nContent-Disposition: form-data; name="image"; filename="x"\r\n\r\n' + PNG + b"\r\n--b--\r\n"
FORMS: dict[str, tuple[str, bytes, int]] = {
    "no boundary": ("multipart/form-data", FORM, 400),
    "another boundary": ("multipart/form-data; boundary=c", FORM, 400),
    "an endless boundary": ("multipart/form-data; boundary=" + "b" * 4000, FORM, 400),
    "no bytes": ("multipart/form-data; boundary=b", b"", 422),
    "half a form": ("multipart/form-data; boundary=b", FORM[: len(FORM) // 2], 422),
    "no name": ("multipart/form-data; boundary=b", FORM.replace(b' name="image";', b""), 400),
    "two files": ("multipart/form-data; boundary=b", FORM.replace(b"--b--\r\n", b"") + FORM, 400),
    "a flood of fields": (
        "multipart/form-data; boundary=b",
        b'--b\r\nContent-Disposition: form-data; name="model"\r\n\r\n\r\n' * 10_000 + b"--b--\r\n",
        400,
    ),
    "a flood of headers": ("multipart/form-data; boundary=b", b"--b\r\n" + b"a: b\r\n" * 100_000, 400),
    "a slow text codec": ("multipart/form-data; boundary=b; charset=punycode", FORM, 415),
    "another type": ("application/json", b"{}", 415),
    "a URL": ("text/uri-list", b"http://169.254.169.254/", 415),
}


@pytest.mark.parametrize("name", FORMS)
def test_a_broken_form_is_refused(client: TestClient, name: str) -> None:
    """A form that is cut short, too long or of another type is refused."""
    content_type, content, status = FORMS[name]
    response = client.post("/v1/contexts", content=content, headers={"Content-Type": content_type})
    assert code(response)[0] == status, response.text


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=300)
@given(st.integers(0, len(FORM)), st.integers(0, len(FORM)), st.binary(max_size=30))
def test_no_broken_form_gets_a_5xx(client: TestClient, start: int, end: int, noise: bytes) -> None:
    """A form with a piece replaced by noise gets an answer or a problem of the request."""
    content = FORM[:start] + noise + FORM[end:]
    response = client.post("/v1/contexts", content=content, headers={"Content-Type": "multipart/form-data; boundary=b"})
    assert response.status_code in (200, 400, 413, 415, 422), response.text
