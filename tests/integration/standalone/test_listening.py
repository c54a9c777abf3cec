"""Other machines, ports and TLS, with another loopback address as the other machine."""

import http.client
import os
import socket
import ssl
from dataclasses import replace
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from kleinkram.standalone import object_store
from kleinkram.standalone.address import Listening, assign_ports, check_listening, public_urls
from kleinkram.standalone.data_dir import DataDir, load_secrets
from kleinkram.standalone.errors import StandaloneError
from kleinkram.standalone.http_client import create_owner_link, request
from kleinkram.standalone.supervisor import stop_instance
from tests.certificate import make_certificate
from tests.integration.standalone.conftest import Instance
from tests.ports import choose_port

ELSEWHERE = "127.0.0.2"


def _open(port: int) -> bool:
    with socket.socket() as probe:
        probe.settimeout(2)
        return probe.connect_ex((ELSEWHERE, port)) == 0


def test_no_service_gets_the_port_that_the_store_computes_for_its_admin_service() -> None:
    listening = Listening(port=choose_port(), s3_port=choose_port())
    first = assign_ports(listening, {})
    assert first["admin_grpc"] == first["admin"] + 10_000
    assert len(set(first.values())) == len(first)
    assert assign_ports(listening, first) == first
    # As instances of earlier versions may have chosen.
    colliding = first | {"filer": first["admin_grpc"]}
    del colliding["admin_grpc"]
    second = assign_ports(listening, colliding)
    assert second["filer"] != second["admin_grpc"] == first["admin"] + 10_000


def test_by_default_only_this_machine_can_connect(shared_instance: Instance) -> None:
    shared_instance.up()
    assert not any(_open(port) for port in shared_instance.runtime_info["ports"].values())
    stop_instance(DataDir(shared_instance.data_dir))


def test_listening_opens_api_and_store_and_nothing_else(shared_instance: Instance) -> None:
    process = shared_instance.up(listening=replace(shared_instance.listening, address="0.0.0.0"))
    runtime_info = shared_instance.runtime_info
    reachable = {name for name, port in runtime_info["ports"].items() if _open(port)}
    assert reachable == {"api", "store"}
    secrets = load_secrets(DataDir(shared_instance.data_dir))
    public = object_store.StoreAccess(runtime_info["store_url"], secrets.s3_access_key, secrets.s3_secret_key)
    assert object_store.request(public, "PUT", "/kleinkram/from-elsewhere", body=b"bytes").status == 200
    assert object_store.request(public, "GET", "/kleinkram/from-elsewhere").body == b"bytes"
    stop_instance(DataDir(shared_instance.data_dir))
    warned = process.communicate(timeout=60)[1]
    assert warned.count("without TLS") == 1
    assert "can read passwords, tokens and recordings" in warned


def test_with_a_certificate_api_and_store_serve_tls(shared_instance: Instance, certificate: tuple[Path, Path]) -> None:
    listening = replace(
        shared_instance.listening,
        address="0.0.0.0",
        public_url=f"https://127.0.0.1:{shared_instance.listening.port}",
        tls_cert=certificate[0],
        tls_key=certificate[1],
    )
    process = shared_instance.up(listening=listening)
    runtime_info = shared_instance.runtime_info
    assert runtime_info["url"].startswith("https://")
    assert runtime_info["store_url"].startswith("https://")
    assert request("GET", f"{runtime_info['url']}/health/live").status == 200
    trusting = ssl.create_default_context(cafile=str(certificate[0]))
    store = http.client.HTTPSConnection(urlsplit(runtime_info["store_url"]).netloc, timeout=5, context=trusting)
    store.request("GET", "/")
    assert store.getresponse().status == 403
    store.close()
    token = Path(runtime_info["token_file"]).read_text().strip()
    assert (
        create_owner_link(runtime_info["local_url"], token, certificate=certificate[0])
        == "http://lab/sign-in/link#good-once"
    )
    (certificate[0].parent / "other").mkdir()
    with pytest.raises(ssl.SSLError):  # the owner's token is for our own server only
        create_owner_link(
            runtime_info["local_url"],
            token,
            certificate=make_certificate(certificate[0].parent / "other", "127.0.0.1")[0],
        )
    stop_instance(DataDir(shared_instance.data_dir))
    assert "without TLS" not in process.communicate(timeout=60)[1]


def test_a_terminal_shows_the_owners_link(shared_instance: Instance) -> None:
    ours, its = os.openpty()
    process = shared_instance.spawn(stdout=its)
    os.close(its)
    with os.fdopen(ours) as terminal:
        assert "answers at" in terminal.readline()
        assert "http://lab/sign-in/link#good-once" in terminal.readline()
        stop_instance(DataDir(shared_instance.data_dir))
    process.communicate(timeout=60)


def test_a_taken_port_is_reported_with_its_program(shared_instance: Instance) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        output = shared_instance.refused(listening=replace(shared_instance.listening, port=port))
    assert f"Port {port} on 127.0.0.1 is taken by " in output
    assert "choose another port with --port" in output
    assert shared_instance.processes == []


def test_a_taken_private_port_is_replaced(shared_instance: Instance) -> None:
    shared_instance.up()
    before = shared_instance.runtime_info["ports"]
    stop_instance(DataDir(shared_instance.data_dir))
    with socket.create_server(("127.0.0.1", before["postgres"])):
        shared_instance.up()
        after = shared_instance.runtime_info["ports"]
        stop_instance(DataDir(shared_instance.data_dir))
    assert after["postgres"] != before["postgres"]
    assert after["store"] == before["store"]


@pytest.mark.parametrize(
    ("listening", "sentence"),
    [
        (Listening(address="lab"), "is no IP address"),
        (Listening(public_url="lab:8000"), "is no URL"),
        (Listening(tls_cert=Path("cert.pem")), "both --tls-cert and --tls-key"),
        (Listening(tls_cert=Path("/none.pem"), tls_key=Path("/none.pem")), "is not there"),
    ],
)
def test_invalid_options_are_refused(listening: Listening, sentence: str) -> None:
    with pytest.raises(StandaloneError, match=sentence):
        check_listening(listening)


def test_the_store_has_the_host_of_the_public_url() -> None:
    listening = Listening(address="0.0.0.0", public_url="http://lab.example:9000/")
    assert public_urls(listening, {"api": 1, "store": 2}) == ("http://lab.example:9000", "http://lab.example:2")


@pytest.fixture
def certificate(tmp_path: Path) -> tuple[Path, Path]:
    """A self-signed certificate for 127.0.0.1, and its key."""
    return make_certificate(tmp_path, "127.0.0.1")
