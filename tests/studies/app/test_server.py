"""The page's server answers the page, and nobody else; nothing that is asked of it leads out of the session's folder."""

import json

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from starlette.testclient import TestClient

from tests.studies.app.conftest import ORIGIN, record

REQUESTS = [
    ("GET", "/"), ("GET", "/static/app.js"), ("GET", "/api/session"), ("PUT", "/api/session"), ("PUT", "/api/records/a.csv"),
    ("DELETE", "/api/records/a.csv"), ("PUT", "/api/texts/plant.py"), ("POST", "/api/texts/plant.py"), ("POST", "/api/steps"),
    ("POST", "/api/sketch"), ("POST", "/api/steps/01-look/stop"), ("GET", "/view/none/records/a.csv"), ("GET", "/nowhere"),
]  # fmt: skip


@pytest.mark.parametrize(("method", "path"), REQUESTS)
def test_who_has_no_token_is_not_answered(app, method, path):
    record(app.session.records / "a.csv", 1)
    client = TestClient(app.asgi, base_url=ORIGIN, headers={"X-Workbench": "1"})
    for query in ("", "?token=", "?token=wrong", f"?token={app.token[:-1]}", f"?token={app.view}"):
        assert client.request(method, path + query).status_code == 403
    client.cookies.set("workbench-8123", app.view)
    assert client.request(method, path).status_code == 403
    assert (app.session.records / "a.csv").is_file()
    assert {p.name for p in app.session.folder.iterdir()} == {"records", ".steps"}


@pytest.mark.parametrize(("method", "path"), [own for own in REQUESTS if own[1] != "/nowhere"])
@pytest.mark.parametrize("headers", [{"Host": "evil.example:8123"}, {"Origin": "https://evil.example"}, {"Origin": "null"}])
def test_another_host_or_origin_is_not_answered_even_with_the_cookie(app, asked, method, path, headers):
    path = path.replace("none", app.view)
    assert asked.request(method, path, headers=headers).status_code == 403


def test_a_form_of_another_page_cannot_change_anything(app, asked):
    """A browser sends a form without asking first; a header of its own it may not set."""
    plain = TestClient(app.asgi, base_url=ORIGIN, cookies=asked.cookies)
    assert plain.post("/api/steps", json={"words": ["look"]}).status_code == 403
    assert plain.get("/api/session").status_code == 200


def test_the_token_leaves_the_address_for_a_cookie_that_no_script_reads(app):
    client = TestClient(app.asgi, base_url=ORIGIN, follow_redirects=False)
    first = client.get(f"/?token={app.token}")
    assert (first.status_code, first.headers["location"]) == (303, "/")
    assert "httponly" in first.headers["set-cookie"].lower()
    assert "samesite=strict" in first.headers["set-cookie"].lower()
    assert "Workbench" in client.get("/").text


@pytest.mark.parametrize(
    "path", ["../secret.txt", "..%2fsecret.txt", "records/../../secret.txt", ".steps/01-look.json", "%2e%2e/secret.txt",
             "/etc/passwd", "records", "link.txt", "a%00.csv", 300 * "x"],
)  # fmt: skip
def test_no_file_outside_of_the_session_is_shown(app, asked, path):
    (app.session.folder.parent / "secret.txt").write_text("secret")
    (app.session.folder / ".steps" / "01-look.json").write_text("{}")
    (app.session.folder / "link.txt").symlink_to(app.session.folder.parent / "secret.txt")
    answer = asked.get(f"/view/{app.view}/{path}")
    assert answer.status_code in (403, 404)  # some are another path already when they leave the browser
    assert "secret" not in answer.text.replace("secret.txt", "")


def test_what_a_session_holds_is_shown_in_a_sandbox(app, asked):
    (app.session.folder / "evil.html").write_text("<script>fetch('/api/session')</script>")
    answer = asked.get(f"/view/{app.view}/evil.html")
    assert answer.status_code == 200
    assert answer.headers["content-security-policy"].startswith("sandbox")
    assert "same-origin" not in answer.headers["content-security-policy"]


@pytest.mark.parametrize("name", ["..", "%2e%2e%2fa.csv", ".hidden", "a%5Cb.csv", "a%00.csv", "x" * 300, "a%0Ab.csv"])
def test_a_record_has_the_name_of_a_file(app, asked, name):
    assert asked.put(f"/api/records/{name}", content=b"t,u\n").status_code in (400, 404, 405)
    assert list(app.session.records.iterdir()) == []


def test_a_record_is_whole_or_not_there(app, asked, monkeypatch):
    assert asked.put("/api/records/a.csv", content=b"t,u\n0,1\n").json() == {"name": "a.csv", "size": 8}
    assert (app.session.records / "a.csv").read_bytes() == b"t,u\n0,1\n"
    monkeypatch.setattr("studies.app.server.LARGEST", 100)
    said = asked.put("/api/records/b.csv", content=b"x" * 101)
    assert said.status_code == 413
    assert "yourself" in said.json()["error"]
    parts = (b"x" * 60 for _ in range(2))  # without a length in front
    assert asked.put("/api/records/b.csv", content=parts).status_code == 413
    assert [p.name for p in app.session.records.iterdir()] == ["a.csv"]


@pytest.mark.parametrize(
    "words", [
        [], ["study", "web-winding"], ["look", "/etc/passwd"], ["look", "../x.csv"], ["look", "records/a.csv", "--out", "x"],
        ["look", "records/a.csv", "--json=x"], ["check", "--limits=/etc/passwd", "--controller", "a"], ["look", "a\0b"],
        ["look", "--nonsense"], ["identify"], ["app"], ["design", "pid", "--model", "C:\\x.json"], ["look", "--help"],
    ],
)  # fmt: skip
def test_only_commands_on_files_of_the_session_are_run(app, asked, words):
    answer = asked.post("/api/steps", json={"words": words})
    assert answer.status_code == 400
    assert "mend" in answer.json()["error"]
    assert app.session.names() == []


@pytest.mark.parametrize("body", [b"", b"[]", b"{", b"\xff\xfe", b"[" * 100_000, b'{"words": "look"}', b'{"words": [1]}'])
def test_what_is_no_request_is_refused(asked, body):
    for method, path in (("PUT", "/api/session"), ("POST", "/api/steps")):
        answer = asked.request(method, path, content=body)
        assert answer.status_code == 400
        assert answer.json()["error"]
    assert asked.put("/api/session", content=b"x" * 2_000_001).status_code == 413


@pytest.mark.parametrize(
    "change", [{"files": {"a.csv": "mine"}}, {"files": 3}, {"roles": {"U": 1}}, {"dt": -1}, {"dt": "x"}, {"plant": 7}, {"new": 1}]
)
def test_a_wrong_entry_of_the_session_is_refused(app, asked, change):
    assert asked.put("/api/session", json={"revision": 0, **change}).status_code == 400
    assert app.session.chosen()["revision"] == 0


def test_of_two_windows_the_slower_one_is_told(asked):
    assert asked.put("/api/session", json={"revision": 0, "roles": {"U": "input"}}).status_code == 200
    late = asked.put("/api/session", json={"revision": 0, "roles": {"U": "output"}})
    assert late.status_code == 400
    assert "another window" in late.json()["error"]
    assert asked.get("/api/session").json()["chosen"]["roles"] == {"U": "input"}


def test_the_state_is_json_whatever_lies_in_the_folder(app, asked):
    folder = app.session.folder
    for name, text in {"01-x/report.json": "{", "02-y/look.json": "[]", "session.json": "no", "03-z/model.json": "[1]"}.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(text)
    (folder / "04-check").mkdir()
    (folder / "04-check" / "report.json").write_text(
        json.dumps({"brief": {"badges": [{"standing": "open"}, {"standing": "good"}]}})
    )
    found = asked.get("/api/session").json()
    assert [(step["name"], step["standing"]) for step in found["steps"]] == [("01-x", ""), ("04-check", "open")]


ASKED = {"controller": "pid.json", "model": "lti.json", "sensitivity": 1.5, "complementary": 1.5, "effort": 3.0}


@pytest.mark.parametrize(
    "change", [{"sensitivity": 0.5}, {"sensitivity": "x"}, {"effort": None}, {"effort": True}, {"controller": "/etc/passwd"},
               {"model": "../x.json"}, {"model": 3}, {}],
)  # fmt: skip
def test_a_sketch_of_what_is_not_there_is_refused(asked, change):
    answer = asked.post("/api/sketch", json=ASKED | change)
    assert answer.status_code == 400
    assert answer.json()["error"]


@pytest.mark.parametrize("content", [{"revision": "x"}, {"files": 3}, {"roles": [1]}, {"dt": "soon", "plant": 7}, []])
def test_a_session_file_of_another_hand_does_not_end_the_page(app, asked, content):
    record(app.session.records / "a.csv", 1)
    (app.session.folder / "session.json").write_text(json.dumps(content))
    found = asked.get("/api/session")
    assert found.status_code == 200
    assert found.json()["chosen"] == {"files": {}, "roles": {}, "dt": None, "plant": "", "revision": 0}


TEXTS = st.text(max_size=30)
VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | TEXTS, lambda own: st.lists(own) | st.dictionaries(TEXTS, own)
)


@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.sampled_from(["GET", "PUT", "POST", "DELETE"]), st.lists(TEXTS, max_size=4), VALUES)
def test_nothing_that_is_asked_ends_the_server(app, asked, method, parts, content):
    """Random paths below the known ones, random bodies: an answer of a few hundred, and no file outside."""
    from urllib.parse import quote

    before = sorted(p.name for p in app.session.folder.parent.iterdir())
    body = json.dumps(content).encode("utf-8", "replace")
    for first in ("api/session", "api/records", "api/texts", "api/steps", "static", f"view/{app.view}", "elsewhere"):
        path = "/".join(["", first, *(quote(part.encode("utf-8", "replace"), safe="") for part in parts)])
        answer = asked.request(method, path, content=body)
        assert answer.status_code < 500, (method, path, body, answer.text)
    assert sorted(p.name for p in app.session.folder.parent.iterdir()) == before
    assert app.session.names() == []
