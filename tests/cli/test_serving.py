"""The server of a page serves this machine alone, and no client can block it."""

import http.client
import socket
import threading
from contextlib import contextmanager

import pytest

from geodrake.cli import play
from geodrake.cli.play import page_server, serve_page
from geodrake.errors import OutputError


@pytest.fixture
def server():
    served = page_server(0)
    served.page = b"<html>the page</html>"
    with thread_of(served.serve_forever, poll_interval=0.02):
        yield served
        served.shutdown()
    served.server_close()


def port_of(server):
    return server.server_address[1]


def asked(server, method="GET", path="/", **headers):
    connection = http.client.HTTPConnection("127.0.0.1", port_of(server), timeout=10)
    connection.request(method, path, headers=headers)
    answer = connection.getresponse()
    return answer, answer.read()


def connected(server):
    return socket.create_connection(("127.0.0.1", port_of(server)), timeout=10)


@contextmanager
def thread_of(target, *args, **kwargs):
    """Run a function in a thread that ends with the block."""
    thread = threading.Thread(target=target, args=args, kwargs=kwargs)
    thread.start()
    yield
    thread.join()


def test_a_page_is_served_on_a_port_of_its_own(capfd):
    server = page_server(0)
    with pytest.raises(OutputError, match=f"Port {port_of(server)} cannot be used"):
        page_server(port_of(server))
    with thread_of(serve_page, server, "<p>played ✓</p>"):
        assert asked(server)[1].decode() == "<p>played ✓</p>"
        server.shutdown()
    server.server_close()
    assert f"Playing at http://localhost:{port_of(server)}/" in capfd.readouterr().err


@pytest.mark.parametrize("host", ["localhost", "127.0.0.1:99", "[::1]:99", "LOCALHOST:1"])
def test_the_page_is_for_this_machine(server, host):
    answer, body = asked(server, Host=host)
    assert (answer.status, body) == (200, server.page)
    assert answer.headers["Server"] == "geodrake"


@pytest.mark.parametrize(
    "host", ["evil.example", "localhost.evil.example", "evil.example:80", "", "[", "127.0.0.1@x"]
)
def test_other_names_of_this_machine_are_refused(server, host):
    for method in ("GET", "HEAD"):
        answer, body = asked(server, method, Host=host)
        assert answer.status == 403
        assert server.page not in body


def test_a_second_host_is_refused(server):
    with connected(server) as client:
        client.sendall(b"GET / HTTP/1.1\r\nHost: localhost\r\nHost: evil.example\r\n\r\n")
        assert client.recv(100).startswith(b"HTTP/1.0 403")


def test_head_requests_get_no_body(server):
    answer, body = asked(server, "HEAD")
    assert (answer.status, body) == (200, b"")
    assert answer.headers["Content-Length"] == str(len(server.page))
    assert asked(server, path="/other")[0].status == 404
    assert asked(server, "POST")[0].status == 501


def test_a_silent_client_is_disconnected(server, monkeypatch):
    monkeypatch.setattr(play._PageHandler, "timeout", 0.1)
    with connected(server) as client:
        assert client.recv(1) == b""


def test_a_client_that_disconnects_is_not_reported(server, capfd):
    server.page = bytes(20_000_000)
    with connected(server) as client:
        client.sendall(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n")
        client.recv(100)
        client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")  # reset
    assert asked(server, "HEAD")[0].status == 200
    assert capfd.readouterr().err == ""


def test_errors_of_the_server_are_reported(server, capfd, monkeypatch):
    monkeypatch.setattr(play._PageHandler, "do_GET", lambda handler: 1 / 0)
    with pytest.raises(http.client.RemoteDisconnected):
        asked(server)
    assert "ZeroDivisionError" in capfd.readouterr().err
