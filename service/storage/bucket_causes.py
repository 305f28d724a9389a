"""Causes of failures of a store in words, each with its cure. Texts of the store and addresses are never repeated.

``fault_of_environment`` finds what is wrong before a request is sent: the library panics for some of these values.
"""

import ipaddress
import os
import re
from collections.abc import Mapping
from typing import Final
from urllib.parse import urlsplit

UNREACHABLE: Final = "the store cannot be reached"
_KEY_ID: Final = "AWS_ACCESS_KEY_ID"
_SECRET: Final = "AWS_SECRET_ACCESS_KEY"  # noqa: S105 (the name of a variable)
_SENT: Final = (
    _KEY_ID,
    _SECRET,
    "AWS_SESSION_TOKEN",
    "AWS_REGION",
    "AWS_DEFAULT_REGION",
    "AWS_ENDPOINT_URL",
    "AWS_ENDPOINT_URL_S3",
)
_URL: Final = re.compile(r"https?://([A-Za-z0-9_.-]+|\[[0-9A-Fa-f:.]+\])(:[0-9]{1,5})?(/[A-Za-z0-9_.~/-]*)?")
_NAME: Final = re.compile(r"[A-Za-z0-9-]{1,64}")
_CODE: Final = re.compile(r"<Code>([A-Za-z]{1,60})</Code>")
_STATUS: Final = re.compile(r"status code: ([0-9]{3})")
_NO_KEYS: Final = f"no keys were found: set {_KEY_ID} and {_SECRET}"
_PROFILE: Final = (
    "; AWS_PROFILE is not read: `aws configure export-credentials --format env` prints the keys of a profile"
)
_REGION: Final = "the bucket lies in another region; set AWS_REGION to it"
_CODES: Final[Mapping[str, str]] = {
    "AccessDenied": "permission denied; the key needs the rights to list and read the bucket, and to write for changes",
    "AllAccessDisabled": "permission denied; the bucket is closed to all keys",
    "AuthorizationHeaderMalformed": _REGION,
    "ExpiredToken": "the credentials have expired; renew them (AWS_SESSION_TOKEN)",
    "IllegalLocationConstraintException": _REGION,
    "InternalError": f"{UNREACHABLE}: it reports an error of its own; try again later",
    "InvalidAccessKeyId": f"the store does not know this key; check {_KEY_ID}",
    "InvalidBucketName": "the store refuses the name of the bucket; check CAZSL_REGISTRY",
    "InvalidToken": "the session token is refused; check AWS_SESSION_TOKEN, or unset it",
    "NoSuchBucket": "there is no such bucket; check CAZSL_REGISTRY, AWS_REGION and AWS_ENDPOINT_URL, or create it",
    "PermanentRedirect": _REGION,
    "RequestTimeTooSkewed": "the clock of this machine differs too much from the store's; set it",
    "ServiceUnavailable": f"{UNREACHABLE}: it is overloaded; try again later",
    "SignatureDoesNotMatch": f"the signature is wrong; check {_SECRET}",
    "SlowDown": f"{UNREACHABLE}: it is overloaded; try again later",
}
_ADDRESS: Final = "check AWS_ENDPOINT_URL and the network"
# Parts of the library's own texts, the most telling first.
_TEXTS: Final[Mapping[str, str]] = {
    "169.254.": _NO_KEYS,  # the address of a machine's role, which is asked if no keys are set
    "Missing AccessKeyId": _NO_KEYS,
    "Missing SecretAccessKey": f"{_SECRET} is not set",
    "BareRedirect": _REGION,
    "dns error": f"{UNREACHABLE}: the name of its host is not known; check AWS_ENDPOINT_URL, AWS_REGION and DNS",
    "ConnectionRefused": f"{UNREACHABLE}: the connection is refused; {_ADDRESS}",
    "InvalidCertificate": f"{UNREACHABLE}: its TLS certificate is not trusted; name its authority in SSL_CERT_FILE",
    "InvalidMessage": f"{UNREACHABLE}: TLS failed; check https:// and the port in AWS_ENDPOINT_URL",
    "AlertReceived": f"{UNREACHABLE}: it ended the TLS handshake; check AWS_ENDPOINT_URL",
    "kind: Timeout": f"{UNREACHABLE}: it did not answer in time; {_ADDRESS}",
}
_STATUSES: Final[Mapping[str, str]] = {
    "401": f"the credentials are refused; check {_KEY_ID} and {_SECRET}",
    "403": "permission denied; check the keys and the rights that they have in this bucket",
    "404": "it answers 404 without saying that an object is missing; check CAZSL_REGISTRY and AWS_ENDPOINT_URL",
}
PANIC: Final = "the library of the bucket failed; check CAZSL_REGISTRY and the AWS_* environment variables"


def code_of(error: BaseException) -> str | None:
    """Return the code that the store gave, or None if its answer had none."""
    found = _CODE.search(str(error))
    return None if found is None else found[1]


def cause_of(error: BaseException) -> str:
    """Return the cause of an error of the library, and its cure."""
    text, code = str(error), code_of(error)
    if code is not None and code in _CODES:
        return _CODES[code]
    for part, cause in _TEXTS.items():
        if part in text:
            return cause + (_PROFILE if cause == _NO_KEYS and os.environ.get("AWS_PROFILE") else "")
    status = _STATUS.search(text)
    if status is None:
        return f"{UNREACHABLE}, or refused the request; {_ADDRESS}"
    return _STATUSES.get(status[1], f"the store refused the request with status {status[1]}; {_ADDRESS}")


def fault_of_environment() -> str | None:
    """Return which variable of the environment cannot be used and why, or None."""
    for name in _SENT:
        value = os.environ.get(name, "")
        if not value.isascii() or not value.isprintable() or value != value.strip():
            return f"{name} has a line break, a space or a letter that cannot be sent; remove it"
    for name in ("AWS_REGION", "AWS_DEFAULT_REGION"):
        if (value := os.environ.get(name, "")) and not _NAME.fullmatch(value):
            return f"{name} is not a region; accepted are letters, digits and '-'"
    for name in ("AWS_ENDPOINT_URL_S3", "AWS_ENDPOINT_URL"):
        if (value := os.environ.get(name, "")) and not _is_address(value):
            return f"{name} is not an address; accepted is http://HOST:PORT or https://HOST:PORT"
    has_id, has_secret = (bool(os.environ.get(name)) for name in (_KEY_ID, _SECRET))
    if has_id != has_secret:
        return f"{_SECRET if has_id else _KEY_ID} is not set, but {_KEY_ID if has_id else _SECRET} is"
    if not has_id and _KEY_ID in os.environ:
        return f"{_KEY_ID} is empty; set it, or unset it"
    return None


def _is_address(text: str) -> bool:
    """Return whether a text is the address of a store. The library panics for hosts and ports that cannot exist."""
    if not _URL.fullmatch(text):
        return False
    try:
        parts = urlsplit(text)
        host, _ = parts.hostname or "", parts.port
        if text.partition("//")[2].startswith("[") or host.rpartition(".")[2].isdigit():
            ipaddress.ip_address(host)
    except ValueError:
        return False
    return True
