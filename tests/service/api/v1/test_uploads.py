"""Images over HTTP: in a form, alone and as base64."""

import base64
import io
import json
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient
from httpx2 import Response
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image
from starlette.datastructures import Headers

from service.api.v1.uploads import read_upload
from service.app import create_app
from service.errors import MalformedBodyError
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
    "two files": ("multipart/form-data; boundary=b", FORM.replace(b"--b--\r\n", b"") + FORM, 422),
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


BOUNDED_FORM = "multipart/form-data; boundary=b"
DISPOSITION = b"Content-Disposition: form-data; name="
MEBIBYTES = 12 << 20
PUSHER_TEXT = json.dumps(PUSHER).encode()


def part(name: bytes, data: bytes, *headers: bytes, after: bytes = b"") -> bytes:
    """Build a part of a form with the boundary b: its name with more parameters, its headers, its data."""
    lines = [b"--b", DISPOSITION + b'"' + name + b'"' + after, *headers, b"", data, b""]
    return b"\r\n".join(lines)


IMAGE_PART = part(b"image", PNG, b"Content-Type: image/png", after=b'; filename="view.png"')
PUSHER_PART = part(b"pusher", PUSHER_TEXT)
END = b"--b--\r\n"


def pusher_part(*headers: bytes, after: bytes = b"", data: bytes = PUSHER_TEXT) -> bytes:
    """Build a form whose part of the pusher has these headers and parameters."""
    return IMAGE_PART + part(b"pusher", data, *headers, after=after) + END


READ_FORMS: dict[str, tuple[str, bytes]] = {
    "plain": (BOUNDED_FORM, IMAGE_PART + PUSHER_PART + END),
    "image last": (BOUNDED_FORM, PUSHER_PART + IMAGE_PART + END),
    "JSON part": (BOUNDED_FORM, pusher_part(b"Content-Type: application/json")),
    "JSON part in UTF-8": (BOUNDED_FORM, pusher_part(b'Content-Type: application/json; charset="UTF-8"')),
    "JSON part with a file name": (
        BOUNDED_FORM,
        pusher_part(b"Content-Type: application/json", after=b'; filename="blob"'),
    ),
    "text part in ASCII": (BOUNDED_FORM, pusher_part(b"Content-Type: text/plain;charset=us-ascii")),
    "ASCII in a part that says Latin-1": (
        BOUNDED_FORM,
        pusher_part(b"Content-Type: text/plain; charset=ISO-8859-1", b"Content-Transfer-Encoding: 8bit"),
    ),
    "binary parts": (BOUNDED_FORM, pusher_part(b"Content-Transfer-Encoding: binary")),
    "8bit parts": (BOUNDED_FORM, pusher_part(b"content-transfer-encoding: 8BIT ", b"Content-Length: 40")),
    "image without a file name": (BOUNDED_FORM, part(b"image", PNG) + PUSHER_PART + END),
    "file name with a semicolon and quotes": (
        BOUNDED_FORM,
        part(b"image", PNG, after=b'; filename="a;b=\\"c\\"; name=d.png"') + PUSHER_PART + END,
    ),
    "file name in another charset": (
        BOUNDED_FORM,
        part(b"image", PNG, after=b"; filename*=UTF-8''%e2%82%ac.png") + PUSHER_PART + END,
    ),
    "file name of other bytes": (BOUNDED_FORM, part(b"image", PNG, after=b'; filename="\xff\xfe"') + PUSHER_PART + END),
    "name without quotes": (
        BOUNDED_FORM,
        (IMAGE_PART + PUSHER_PART + END).replace(b'name="pusher"', b"name=pusher"),
    ),
    "headers in capital letters": (
        BOUNDED_FORM,
        (IMAGE_PART + PUSHER_PART + END).replace(b"Content-Disposition: form-data", b"CONTENT-DISPOSITION:Form-Data"),
    ),
    "preamble": (BOUNDED_FORM, b"This is a form.\r\n" + IMAGE_PART + PUSHER_PART + END),
    "preamble of an empty line": (BOUNDED_FORM, b"\r\n" + IMAGE_PART + PUSHER_PART + END),
    "preamble that begins like a boundary": (BOUNDED_FORM, b"--a\r\n" + IMAGE_PART + PUSHER_PART + END),
    "epilogue": (BOUNDED_FORM, IMAGE_PART + PUSHER_PART + END + b"the end\r\n" * 9000 + b"--b\r\n"),
    "no line behind the end": (BOUNDED_FORM, (IMAGE_PART + PUSHER_PART + END)[:-2]),
    "blanks behind a boundary": (
        BOUNDED_FORM,
        (IMAGE_PART + PUSHER_PART + END).replace(b"--b\r\n" + DISPOSITION + b'"p', b"--b \t\r\n" + DISPOSITION + b'"p'),
    ),
    "quoted boundary": ('multipart/form-data; boundary="b"', IMAGE_PART + PUSHER_PART + END),
    "charset of the form": ("multipart/form-data; charset=UTF-8; boundary=b", IMAGE_PART + PUSHER_PART + END),
    "quoted charset of the form": ('Multipart/Form-Data; Boundary=b; Charset="utf-8"', IMAGE_PART + PUSHER_PART + END),
    "charset of a browser": (BOUNDED_FORM, part(b"_charset_", b"UTF-8") + IMAGE_PART + PUSHER_PART + END),
    "model beside it": (BOUNDED_FORM, IMAGE_PART + part(b"model", b"push-visual") + PUSHER_PART + END),
}
# Forms that are refused, each with its status and the text of the detail, which names the field.
REFUSED_FORMS: dict[str, tuple[str, bytes, int, str]] = {
    "base64": (BOUNDED_FORM, pusher_part(b"Content-Transfer-Encoding: base64"), 422, "body.pusher: received an enc"),
    "an image in base64": (
        BOUNDED_FORM,
        part(b"image", base64.b64encode(PNG), b"Content-Transfer-Encoding: BASE64") + PUSHER_PART + END,
        422,
        "body.image: received an encoded part",
    ),
    "quoted-printable": (
        BOUNDED_FORM,
        pusher_part(b"Content-Transfer-Encoding: quoted-printable"),
        422,
        "body.pusher: received an encoded part",
    ),
    "a part in UTF-16": (
        BOUNDED_FORM,
        pusher_part(b"Content-Type: application/json; charset=utf-16", data=json.dumps(PUSHER).encode("utf-16")),
        422,
        "body.pusher: received a text in another charset; accepted is UTF-8",
    ),
    "a part in Latin-1": (
        BOUNDED_FORM,
        pusher_part(b"Content-Type: text/plain; charset=ISO-8859-1", data=b'{"x": "\xe9"}'),
        422,
        "body.pusher: received a text in another charset; accepted is UTF-8",
    ),
    "a slow codec of a part": (BOUNDED_FORM, pusher_part(b"Content-Type: a/b; charset=punycode"), 422, "body.pusher"),
    "another charset of a browser": (
        BOUNDED_FORM,
        part(b"_charset_", b"utf-7") + IMAGE_PART + PUSHER_PART + END,
        422,
        "body._charset_",
    ),
    "a model that is not UTF-8": (BOUNDED_FORM, IMAGE_PART + part(b"model", b"\xff") + END, 422, "body.model"),
    "no JSON": (BOUNDED_FORM, pusher_part(b"Content-Type: application/json", data=b"{"), 422, "body.pusher"),
    "a pusher that is not UTF-8": (BOUNDED_FORM, pusher_part(data=b'{"x": "\xff"}'), 422, "body.pusher"),
    "two pushers": (BOUNDED_FORM, IMAGE_PART + PUSHER_PART * 2 + END, 422, "body.pusher: received a second part"),
    "no image": (BOUNDED_FORM, PUSHER_PART + END, 422, "body.image"),
    "an unknown part": (BOUNDED_FORM, IMAGE_PART + part(b"<script>", b"") + END, 422, "body: received an unknown part"),
    "a name in another charset": (
        BOUNDED_FORM,
        IMAGE_PART.replace(b'name="image"', b"name*=UTF-8''image") + END,
        400,
        "a part without a name",
    ),
    "a part that is no form data": (
        BOUNDED_FORM,
        IMAGE_PART.replace(b"form-data", b"attachment") + END,
        400,
        "a part without a name",
    ),
    "two names": (
        BOUNDED_FORM,
        pusher_part(DISPOSITION + b'"model"'),
        400,
        "a repeated header",
    ),
    "a continued header": (BOUNDED_FORM, pusher_part(b" continued"), 400, "body: received another kind of form"),
    "lines that end with LF": (
        BOUNDED_FORM,
        (PUSHER_PART + END).replace(b"\r\n", b"\n"),
        400,
        "lines that end with CR LF",
    ),
    "no last boundary": (BOUNDED_FORM, IMAGE_PART + PUSHER_PART, 422, "body: received a form that stops"),
    "no boundary in the header": ("multipart/form-data", FORM, 400, "header Content-Type: received a form without"),
    "a charset of the form": ("multipart/form-data; boundary=b; charset=utf-16", FORM, 415, "header Content-Type"),
    "a header of many parameters": (BOUNDED_FORM + ";a=b" * 900, FORM, 400, "header Content-Type"),
    "nine headers": (BOUNDED_FORM, pusher_part(*(b"X-%d: y" % n for n in range(8))), 400, "body: received another"),
    "a long header": (BOUNDED_FORM, pusher_part(b"X: " + b"y" * 5000), 400, "body: received another"),
    "a long preamble": (BOUNDED_FORM, b"p" * (1 << 16) + b"\r\n" + FORM, 400, "another boundary"),
    "many parts": (BOUNDED_FORM, part(b"model", b"") * 20 + END, 400, "too many parts"),
}


@pytest.mark.parametrize("name", READ_FORMS)
def test_every_kind_of_form_gets_the_same_answer(client: TestClient, name: str) -> None:
    """A form in every variety that RFC 7578 permits is answered like the plain one, on both routes."""
    content_type, content = READ_FORMS[name]
    for route in ("/v1/predict/image", "/v1/contexts"):
        expected = client.post(route, content=READ_FORMS["plain"][1], headers={"Content-Type": READ_FORMS["plain"][0]})
        response = client.post(route, content=content, headers={"Content-Type": content_type})
        assert response.status_code == 200, response.text
        assert response.content == expected.content


@pytest.mark.parametrize("route", ["/v1/predict/image", "/v1/contexts"])
@pytest.mark.parametrize("name", REFUSED_FORMS)
def test_every_other_form_is_refused_by_its_field(client: TestClient, name: str, route: str) -> None:
    """A form that is not read is refused, and the detail names the field or the fault, and no text of the form."""
    content_type, content, status, words = REFUSED_FORMS[name]
    response = client.post(route, content=content, headers={"Content-Type": content_type})
    assert code(response)[0] == status, response.text
    assert words in response.json()["detail"]
    assert "script" not in response.text
    assert len(response.content) < 1000


# Forms of 12 MiB that would keep a parser busy byte by byte, or boundary by boundary.
COSTLY_FORMS: dict[str, tuple[bytes, str]] = {
    "empty lines": (b"\r\n" * (MEBIBYTES // 2), "another boundary"),
    "carriage returns": (b"\r" * MEBIBYTES, "another boundary"),
    "hyphens": (b"-" * MEBIBYTES, "another boundary"),
    "blanks behind a boundary": (b"--b" + b" " * MEBIBYTES, "another kind of form"),
    "blanks behind a second boundary": (IMAGE_PART + b"--b" + b"\t" * MEBIBYTES, "a run of blanks"),
    "almost boundaries": (IMAGE_PART[:-2] + b"\r\n--bb" * (MEBIBYTES // 6), "too many parts"),
    "almost last boundaries": (IMAGE_PART[:-2] + b"\r\n--b-" * (MEBIBYTES // 6), "too many parts"),
    "parts": (b"--b\r\n\r\n\r\n" * (MEBIBYTES // 9), "too many parts"),
    "blanks in a header": (b"--b\r\nX:" + b" " * MEBIBYTES, "another kind of form"),
    "a header's name": (b"--b\r\n" + b"x" * MEBIBYTES, "another kind of form"),
    "a header's value": (b"--b\r\nX: " + b"x" * MEBIBYTES, "another kind of form"),
}


@pytest.mark.parametrize("name", COSTLY_FORMS)
def test_a_costly_form_is_refused_at_its_first_fault(name: str) -> None:
    """A form of 12 MiB is refused after a piece of it: the reader calls few functions, whatever its length."""
    content, words = COSTLY_FORMS[name]
    calls = 0

    def count(_frame: object, _event: str, _argument: object) -> None:
        """Count the calls of functions."""
        nonlocal calls
        calls += 1

    sys.setprofile(count)
    try:
        with pytest.raises(MalformedBodyError, match=words):
            read_upload(Headers({"content-type": BOUNDED_FORM}), content)
    finally:
        sys.setprofile(None)
    assert calls < 100_000


def test_the_data_of_a_part_is_kept_wherever_its_pieces_end() -> None:
    """A part of any length has its own bytes, with almost boundaries across the ends of the reader's pieces."""
    for length in range((1 << 16) - 140, (1 << 16) - 90):
        data = b"\r\n--" + bytes(length) + b"\r\n--c\r\n--\r\n" + bytes(70_000)
        found = read_upload(Headers({"content-type": BOUNDED_FORM}), part(b"image", data) + END)
        assert found.image == data


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=300)
@given(st.integers(0, len(FORM)), st.integers(0, len(FORM)), st.binary(max_size=30))
def test_no_broken_form_gets_a_5xx(client: TestClient, start: int, end: int, noise: bytes) -> None:
    """A form with a piece replaced by noise gets an answer or a problem of the request."""
    content = FORM[:start] + noise + FORM[end:]
    response = client.post("/v1/contexts", content=content, headers={"Content-Type": "multipart/form-data; boundary=b"})
    assert response.status_code in (200, 400, 413, 415, 422), response.text
