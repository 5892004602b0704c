"""The viewer behind a reverse proxy with TLS: nginx as Debian ships it, and below a path."""

import shutil
import socket
import ssl
import subprocess
import sys
import urllib.request

import pytest
from viewer_helpers import PATIENCE, WINDOW, blob, middle, stroke, until, view

pytest.importorskip("websockets")

BROWSERS = True  # see hang_guard
NGINX = shutil.which("nginx") or shutil.which("nginx", path="/usr/sbin")
CONFIGURATION = """
daemon off;
pid {folder}/nginx.pid;
error_log {folder}/error.log;
events {{}}
http {{
  access_log off;
  client_body_temp_path {folder}/body; proxy_temp_path {folder}/proxy;
  fastcgi_temp_path {folder}/fastcgi; uwsgi_temp_path {folder}/uwsgi; scgi_temp_path {folder}/scgi;
  server {{
    listen 127.0.0.1:{port} ssl;
    ssl_certificate {folder}/cert.pem;
    ssl_certificate_key {folder}/key.pem;
    location /view {{
      rewrite ^/view/?(.*)$ /$1 break;
      proxy_pass http://127.0.0.1:{inner};
      proxy_http_version 1.1;
      proxy_set_header Upgrade $http_upgrade;
      proxy_set_header Connection "upgrade";
      proxy_set_header Host $http_host;
      proxy_set_header X-Forwarded-Proto $scheme;
      proxy_read_timeout 1h;
    }}
  }}
}}
"""


def free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


@pytest.fixture
def behind(tmp_path):
    if NGINX is None:
        pytest.skip("no nginx: apt-get install nginx")
    if shutil.which("openssl") is None:
        pytest.skip("no openssl")
    subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj",
         "/CN=localhost", "-keyout", tmp_path / "key.pem", "-out", tmp_path / "cert.pem"],
        check=True, capture_output=True,
    )  # fmt: skip
    viewer, port = view(blob(300), demand_token=True), free_port()
    (tmp_path / "nginx.conf").write_text(CONFIGURATION.format(folder=tmp_path, port=port, inner=viewer.port))
    words = [NGINX, "-c", str(tmp_path / "nginx.conf"), "-e", str(tmp_path / "error.log")]
    proxy, address = subprocess.Popen(words, stdout=sys.stderr), f"https://localhost:{port}/view/"

    def answers():
        assert proxy.poll() is None, (tmp_path / "error.log").read_text()
        with socket.socket() as one:
            return one.connect_ex(("127.0.0.1", port)) == 0

    try:
        until(answers, "for nginx")
        yield viewer, address
    finally:
        proxy.terminate()
        proxy.wait(PATIENCE)
        viewer.close()


def test_the_token_and_the_cookie_behind_a_proxy(behind):
    viewer, address = behind
    trusting = ssl.create_default_context()
    trusting.check_hostname, trusting.verify_mode = False, ssl.CERT_NONE

    def ask(path):
        return urllib.request.urlopen(address + path, context=trusting, timeout=PATIENCE)

    with pytest.raises(urllib.error.HTTPError, match="403"):
        ask("")
    with ask(f"look/?token={viewer.look_token}") as answer:
        assert "; Secure" in answer.headers["Set-Cookie"]
        assert b'src="globule/desk.js"' in answer.read()


@pytest.mark.browser
@pytest.mark.slow
def test_a_browser_behind_a_proxy(behind, chromium):
    viewer, address = behind
    context = chromium.new_context(ignore_https_errors=True, viewport=WINDOW)
    try:
        context.add_init_script("localStorage['globule-hints'] = 'seen'")
        page, sockets = context.new_page(), []
        page.on("websocket", lambda socket: sockets.append(socket.url))
        page.goto(f"{address}?token={viewer.token}")
        until(lambda: viewer.clients, "for the page to connect")
        (client,) = viewer.clients.values()
        until(lambda: client.number > 0 and not client.pacer.in_flight, "for an image")
        desk = page.locator("#globule-desk")
        desk.get_by_role("button", name="Cutting plane").click()
        until(lambda: viewer.state.cuts.plane)
        before = client.camera
        beside = middle(page) + (-110, 120)  # the handle of the plane
        stroke(page, beside, beside + (60, 30))
        until(lambda: client.camera != before, "for the camera to move")
        assert sockets
        assert all(url.startswith(address.replace("https", "wss", 1)[:-1]) for url in sockets)
    finally:
        context.close()
