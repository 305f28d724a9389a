"""Programs of other languages that send one request, for the tests: Java's HttpClient, node's fetch, curl.

Each prints the status and the body of the answer. The body to send is a file, which may be large.
"""

import json
import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Final

_JAVA: Final = """
import java.net.URI;
import java.net.http.*;
import java.nio.file.Path;

public class Post {
    public static void main(String[] given) throws Exception {
        HttpClient client = HttpClient.newHttpClient();
        for (int turn = 0; turn < Integer.parseInt(given[2]); turn++) {
            HttpRequest.Builder request = HttpRequest.newBuilder(URI.create(given[0]));
            for (int name = 3; name + 1 < given.length; name += 2) request.header(given[name], given[name + 1]);
            request.POST(HttpRequest.BodyPublishers.ofFile(Path.of(given[1])));
            HttpResponse<String> answer = client.send(request.build(), HttpResponse.BodyHandlers.ofString());
            System.out.println(answer.statusCode() + " " + answer.body());
        }
    }
}
"""
_NODE: Final = """
const [url, path, turns, ...fields] = process.argv.slice(1)
const body = require("fs").readFileSync(path)
const headers = {}
for (let i = 0; i < fields.length; i += 2) headers[fields[i]] = fields[i + 1]
;(async () => {
  for (let turn = 0; turn < Number(turns); turn++) {
    const answer = await fetch(url, { method: "POST", headers, body })
    console.log(answer.status + " " + await answer.text())
  }
})()
"""
PROGRAMS: Final = ("java", "node", "curl", "curl --http2", "curl -0")
_PATIENCE_S: Final = 60.0


def is_installed(program: str) -> bool:
    """Return True if a program can run here."""
    return all(shutil.which(name) for name in (("java", "javac") if program == "java" else (program.split()[0],)))


def _compile(folder: Path) -> None:
    (folder / "Post.java").write_text(_JAVA)
    command = [shutil.which("javac") or "javac", "-d", str(folder), str(folder / "Post.java")]
    subprocess.run(command, check=True, timeout=_PATIENCE_S)


def posted(
    program: str, folder: Path, url: str, body: bytes, headers: Mapping[str, str], turns: int = 1
) -> list[tuple[int, str]]:
    """Send a body with a program as often as wanted. Return status and text of the answers."""
    file = folder / "body"
    file.write_bytes(body)
    fields = [text for pair in headers.items() for text in pair]
    if program == "java":
        if not (folder / "Post.class").exists():
            _compile(folder)
        command = ["java", "-cp", str(folder), "Post", url, str(file), str(turns), *fields]
    elif program == "node":
        command = ["node", "-e", _NODE, "--", url, str(file), str(turns), *fields]
    else:
        given = [text for name, value in headers.items() for text in ("-H", f"{name}: {value}")]
        one = [
            "-sS",
            "-X",
            "POST",
            *program.split()[1:],
            *given,
            "--data-binary",
            f"@{file}",
            "-w",
            " %{http_code}\n",
            url,
        ]
        command = ["curl", *one, *(["--next", *one] * (turns - 1))]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=_PATIENCE_S)
    assert done.returncode == 0, (done.stdout, done.stderr)
    answers = []
    for line in done.stdout.splitlines():
        if program.startswith("curl"):
            text, _, status = line.rpartition(" ")
        else:
            status, _, text = line.partition(" ")
        json.loads(text)
        answers.append((int(status), text))
    return answers
