"""The local page is served to this machine alone, and nothing else is."""

import http.client
import os
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from framework.command.config.schema import ROOT
from framework.errors import UserError
from framework.view.server import HOST, PageServer
from tests.view.runs import seen_run

PAGE = "<!doctype html><p>ü</p>"


@pytest.fixture
def server() -> Iterator[PageServer]:
    with PageServer(PAGE) as built:
        threading.Thread(target=built.serve_forever, daemon=True).start()
        yield built
        built.shutdown()


def ask(
    server: PageServer, path: str = "/", method: str = "GET", host: str | None = None
) -> tuple[int, bytes]:
    connection = http.client.HTTPConnection(HOST, server.server_port, timeout=20)
    headers = {} if host is None else {"Host": host}
    connection.request(method, path, headers=headers)
    answer = connection.getresponse()
    return answer.status, answer.read()


def test_it_serves_the_page_and_nothing_else(server: PageServer) -> None:
    assert server.server_address[0] == "127.0.0.1"
    assert ask(server) == (200, PAGE.encode())
    assert ask(server, "/?x=1") == (200, PAGE.encode())
    assert ask(server, method="HEAD") == (200, b"")
    for path in ("/index.html", "/../etc/passwd", "/%2e%2e/"):
        assert ask(server, path)[0] == 404
    assert ask(server, "http://elsewhere/")[0] == 403
    assert ask(server, method="POST")[0] == 501


def test_a_page_from_elsewhere_may_not_read_it(server: PageServer) -> None:
    assert ask(server, host=f"localhost:{server.server_port}")[0] == 200
    for host in ("elsewhere.example", f"elsewhere.example:{server.server_port}", ""):
        assert ask(server, host=host)[0] == 403


def test_a_port_in_use_is_told_in_a_line(server: PageServer) -> None:
    with pytest.raises(UserError, match=f"expected a free port, got {server.server_port}"):
        PageServer(PAGE, server.server_port)


def test_the_command_serves_until_ctrl_c(tmp_path: Path) -> None:
    run = seen_run(tmp_path)
    code = "import sys; from framework.command.cli import main; sys.exit(main(sys.argv[1:]))"
    without = {"DISPLAY", "WAYLAND_DISPLAY", "BROWSER"}
    process = subprocess.Popen(
        [sys.executable, "-c", code, "view", str(run)],
        cwd=ROOT,
        env={key: value for key, value in os.environ.items() if key not in without},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # a shell's background jobs, CI's too, ignore the signal, and so would their children
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        message = re.match(
            r"view: http://127\.0\.0\.1:(\d+)/ \(Ctrl-C ends it; no screen here", line
        )
        assert message, line
        connection = http.client.HTTPConnection(HOST, int(message[1]), timeout=60)
        connection.request("GET", "/")
        assert b"<canvas" in connection.getresponse().read()
        process.send_signal(signal.SIGINT)
        rest, complaints = process.communicate(timeout=60)
    finally:
        process.kill()
    assert (process.returncode, rest, complaints) == (0, "view: ended\n", "")
