"""The page's server: on this machine alone, and for nobody without the token that it was started with.

Every request must come from the page itself: with its cookie, for this host, and what changes anything from this origin. Files
that a session holds are shown under a second secret, in a sandbox that can ask this server for nothing.
"""

import hmac
import json
import math
import secrets
import shutil
import webbrowser
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import anyio
import uvicorn
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.middleware.base import BaseHTTPMiddleware
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, JSONResponse, PlainTextResponse, RedirectResponse, Response
from starlette.routing import Route

from plants import PLANTS
from studies.app.session import Session
from workbench.errors import InputError
from workbench.report.sheet import VARIABLES

STATIC = Path(__file__).parent / "static"
TYPES = {"app.js": "text/javascript", "app.css": "text/css"}
HIGHEST = 65_535  # port
BODY = 2_000_000  # bytes of a request that is no file
LARGEST, SPARE = 4 * 2**30, 2**29  # bytes of a log; that must stay free on the disk
PAGE_POLICY = "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src data:; frame-src 'self'"
#: What a session holds is shown as if from elsewhere: its scripts run, and can reach nothing.
VIEW_POLICY = "sandbox allow-scripts allow-popups allow-downloads"


class App:
    """The requests of one session: `asgi` is what a server runs, `token` what it asks of everyone, `view` the secret of files."""

    def __init__(self, session: Session, origin: str = ""):
        self.session, self.origin = session, origin
        self.token, self.view = secrets.token_urlsafe(32), secrets.token_urlsafe(32)
        self.asgi = Starlette(
            routes=[
                Route("/", self.page),
                Route("/static/{name}", self.static),
                Route("/view/{secret}/{path:path}", self.shown),
                Route("/api/session", self.state),
                Route("/api/session", self.choose, methods=["PUT"]),
                Route("/api/records/{name}", self.take, methods=["PUT"]),
                Route("/api/records/{name}", self.drop, methods=["DELETE"]),
                Route("/api/texts/{name}", self.write, methods=["PUT"]),
                Route("/api/texts/{name}", self.guess, methods=["POST"]),
                Route("/api/steps", self.begin, methods=["POST"]),
                Route("/api/sketch", self.sketch, methods=["POST"]),
                Route("/api/steps/{name}/stop", self.stop, methods=["POST"]),
            ],
            middleware=[Middleware(BaseHTTPMiddleware, dispatch=self._guarded)],
            exception_handlers={InputError: _refused, HTTPException: _failed, OSError: _gone},  # pyright: ignore[reportArgumentType]
        )

    @property
    def address(self) -> str:
        """What to open in a browser."""
        return f"{self.origin}/?token={self.token}"

    @property
    def _cookie(self) -> str:
        """A cookie's name: browsers do not tell ports of one host apart."""
        return f"workbench-{self.origin.rpartition(':')[2]}"

    # ---- who may ask -------------------------------------------------------------------------------------------------

    async def _guarded(self, request: Request, answer: Callable[[Request], Awaitable[Response]]) -> Response:
        """Answer who has the token, under this host's name, and changes come from this page; nobody else."""
        if reason := self._wrong(request):
            return PlainTextResponse(f"{reason}: open the address that workbench app has printed\n", 403)
        response = await answer(request)
        response.headers["X-Content-Type-Options"] = "nosniff"
        response.headers["Referrer-Policy"] = "no-referrer"
        response.headers["Cache-Control"] = "no-store"
        response.headers.setdefault("Content-Security-Policy", PAGE_POLICY)
        return response

    def _wrong(self, request: Request) -> str:
        """Why a request is not answered; empty where it is."""
        if request.headers.get("host", "") != self.origin.removeprefix("http://"):
            return "another host"  # a page elsewhere whose name was pointed here
        if request.headers.get("origin", self.origin) != self.origin:
            return "another origin"
        if request.url.path.startswith("/view/"):
            return "" if _same(request.url.path.split("/")[2], self.view) else "no token"
        given = request.query_params.get("token", "") if request.url.path == "/" else ""
        given = given or request.cookies.get(self._cookie, "")
        if not _same(given, self.token):
            return "no token"
        changing = request.method not in ("GET", "HEAD")
        return "no origin" if changing and request.headers.get("x-workbench") != "1" else ""

    # ---- what is answered ----------------------------------------------------------------------------------------------

    async def page(self, request: Request) -> Response:
        if "token" in request.query_params:  # out of the address, into a cookie
            response = RedirectResponse("/", 303)
            response.set_cookie(self._cookie, self.token, httponly=True, samesite="strict")
            return response
        return FileResponse(STATIC / "index.html")

    async def static(self, request: Request) -> Response:
        name = request.path_params["name"]
        if name not in TYPES:
            raise HTTPException(404, "no such file")
        if name == "app.css":
            return Response(VARIABLES + (STATIC / name).read_text(encoding="utf-8"), media_type=TYPES[name])
        return FileResponse(STATIC / name, media_type=TYPES[name])

    async def shown(self, request: Request) -> Response:
        """A file of the session."""
        root = self.session.folder.resolve()
        try:
            path = (root / request.path_params["path"]).resolve()
            inside = path.is_relative_to(root) and not any(part.startswith(".") for part in path.relative_to(root).parts)
            there = inside and path.is_file()
        except (ValueError, OSError):  # a NUL, a name that is too long
            there = False
        if not there:
            raise HTTPException(404, "no such file in this session")
        return FileResponse(path, headers={"Content-Security-Policy": VIEW_POLICY})

    async def state(self, request: Request) -> Response:
        found = await run_in_threadpool(self.session.state)
        return JSONResponse(found | {"view": f"/view/{self.view}", "machines": list(PLANTS)})

    async def choose(self, request: Request) -> Response:
        content = await _json(request)
        changes = {key: value for key, value in content.items() if key != "revision"}
        return JSONResponse(await run_in_threadpool(self.session.choose, _whole(content.get("revision")), changes))

    async def take(self, request: Request) -> Response:
        """A log, as it comes; whole or not at all."""
        path = self.session.records / _file_name(request.path_params["name"])
        part = path.with_name(f".{secrets.token_hex(8)}.part")
        said = request.headers.get("content-length", "0")
        room = shutil.disk_usage(self.session.records).free - SPARE
        most = min(LARGEST, room)
        if said.isdigit() and int(said) > most:
            raise HTTPException(413, f"{int(said)} bytes: at most {most} fit; put the file into {self.session.records} yourself")
        size = 0
        try:
            async with await anyio.open_file(part, "wb") as stream:
                async for chunk in request.stream():
                    size += len(chunk)
                    if size > most:
                        raise HTTPException(413, f"more than {most} bytes")
                    await stream.write(chunk)
            part.replace(path)
        except ClientDisconnect:
            raise HTTPException(400, "the log did not come whole") from None
        finally:
            part.unlink(missing_ok=True)
        return JSONResponse({"name": path.name, "size": size})

    async def drop(self, request: Request) -> Response:
        path = self.session.records / _file_name(request.path_params["name"])
        if not path.is_file():
            raise HTTPException(404, "no such record")
        path.unlink()
        return JSONResponse({})

    async def write(self, request: Request) -> Response:
        content = await _json(request)
        await run_in_threadpool(self.session.write, request.path_params["name"], str(content.get("text", "")))
        return JSONResponse({})

    async def guess(self, request: Request) -> Response:
        await run_in_threadpool(self.session.guess, request.path_params["name"])
        return JSONResponse({})

    async def begin(self, request: Request) -> Response:
        words = (await _json(request)).get("words")
        if not isinstance(words, list) or not all(isinstance(word, str) for word in words):
            raise HTTPException(400, "words: a list of texts")
        return JSONResponse({"name": await run_in_threadpool(self.session.begin, words)})

    async def sketch(self, request: Request) -> Response:
        content = await _json(request)
        controller, model = content.get("controller"), content.get("model")
        bounds: dict[str, Any] = {key: content.get(key) for key in ("sensitivity", "complementary", "effort")}
        if not (isinstance(controller, str) and isinstance(model, str)) or not all(_finite(value) for value in bounds.values()):
            raise HTTPException(400, "controller, model: files; sensitivity, complementary, effort: numbers")
        return JSONResponse(await run_in_threadpool(self.session.sketch, controller, model, bounds))

    async def stop(self, request: Request) -> Response:
        await run_in_threadpool(self.session.stop, request.path_params["name"])
        return JSONResponse({})


def _same(given: str, wanted: str) -> bool:
    return hmac.compare_digest(given.encode("utf-8", "replace"), wanted.encode())


def _finite(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _whole(value: Any) -> int:
    if not isinstance(value, int):
        raise HTTPException(400, "revision: a whole number")
    return value


async def _json(request: Request) -> dict[str, Any]:
    """The object that a request holds."""
    text = b""
    async for chunk in request.stream():
        text += chunk
        if len(text) > BODY:
            raise HTTPException(413, f"more than {BODY} bytes")
    try:
        content = json.loads(text)
    except (ValueError, RecursionError):  # no JSON, no UTF-8, or brackets without end
        content = None
    if not isinstance(content, dict):
        raise HTTPException(400, "expected a JSON object")
    return content


def _file_name(name: str) -> str:
    """A name of a file in a folder, and of nothing else."""
    if name != Path(name.replace("\\", "/")).name or name.startswith(".") or len(name.encode()) > 200 or not name.isprintable():
        raise HTTPException(400, f"{name!r} is no name of a file")
    return name


async def _refused(request: Request, reason: Exception) -> Response:
    return JSONResponse({"error": str(reason)}, 400)


async def _gone(request: Request, reason: Exception) -> Response:
    """A file that went between two looks, or a disk that is full."""
    return JSONResponse({"error": f"{reason}: try again"}, 503)


async def _failed(request: Request, reason: Exception) -> Response:
    assert isinstance(reason, HTTPException)
    return JSONResponse({"error": reason.detail}, reason.status_code)


def serve(folder: Path, port: int, say: Callable[[str], None], *, browser: bool) -> None:
    """Serve the session in a folder on 127.0.0.1 until interrupted. port: 0 for any that is free; browser: open the page there.

    Commands that run go on when the server ends; the page shows them again when it is started anew.
    """
    if port > HIGHEST:
        raise InputError(f"port {port}", mend=f"choose a --port up to {HIGHEST}, or none: a free one is found")
    app = App(Session(folder))
    config = uvicorn.Config(app.asgi, host="127.0.0.1", port=port, log_level="critical", access_log=False)
    try:
        bound = config.bind_socket()
    except SystemExit:  # uvicorn has said why
        raise InputError(f"port {port} is taken", mend="choose another --port, or none: a free one is found") from None
    bound.listen()  # a browser that is faster than the server waits for it
    app.origin = f"http://127.0.0.1:{bound.getsockname()[1]}"
    say(f"session: {folder}")
    say(f"open: {app.address}")
    say("it answers on this machine alone, and to who has this address alone; Ctrl-C ends it, commands under way go on")
    if browser:
        webbrowser.open(app.address)
    uvicorn.Server(config).run(sockets=[bound])
