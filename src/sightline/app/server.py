"""Web server of the page: files of the package, pictures, and answers as they come."""

import asyncio
import json
import mimetypes
from collections.abc import AsyncGenerator, AsyncIterator, Awaitable, Callable
from contextlib import aclosing, asynccontextmanager
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.routing import Route

from sightline.app.answers import Answers
from sightline.app.breaking import reproducing_commands
from sightline.app.guard import Guard
from sightline.app.parts import PartMaker, PartName
from sightline.app.setup import page_setup
from sightline.app.state import PageState, parse_state
from sightline.app.timeline import health_along
from sightline.app.workers import Workers
from sightline.data.datasets.sample_dataset import SampleDataset
from sightline.export.names import EngineChoice
from sightline.files.problem import plain_line

MAX_STREAMS: Final = 16
"""Most answers sent at the same time, each to another tab."""

_PARTS_OF_FILES: Final[dict[str, PartName]] = {
    "image": "scene",
    "points": "scene",
    "depth": "depth-completion",
    "uncertainty": "depth-completion",
}
_CLOSING: Final[set["asyncio.Task[None]"]] = set()
_STATIC: Final = files("sightline.app").joinpath("static")


@dataclass(frozen=True, kw_only=True, slots=True)
class PageSettings:
    """Data of a page, and its readers."""

    data: Path
    dataset: SampleDataset
    title: str
    """Name of the data on the page."""
    workers: int = 2
    engine: EngineChoice = "auto"
    hosts: tuple[str, ...] = ()
    """Names by which the server may be called, without port."""
    token: str | None = None


def make_app(settings: PageSettings, maker: PartMaker) -> Starlette:
    """Make the server's application; its worker processes have copies of the maker."""

    @asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        workers = Workers(maker, settings.workers)
        app.state.page = _Page(settings, Answers(workers.run, stamp=maker.stamp), workers)
        try:
            yield
        finally:
            workers.close()

    guard = Middleware(Guard, hosts=settings.hosts, token=settings.token)
    routes = [
        Route("/", _static_file),
        Route("/static/{name}", _static_file),
        Route("/api/setup", _of_page(_Page.setup)),
        Route("/api/scene", _of_page(_Page.scene)),
        Route("/api/file/{name}", _of_page(_Page.file)),
        Route("/api/answers", _of_page(_Page.answers)),
        Route("/api/timeline", _of_page(_Page.timeline)),
        Route("/api/commands", _of_page(_Page.commands)),
    ]
    faults = {ValueError: _on_value_error, OSError: _on_value_error}
    return Starlette(
        routes=routes, middleware=[guard], exception_handlers=faults, lifespan=lifespan
    )


class _Page:
    """Answers to the requests of a page."""

    def __init__(self, settings: PageSettings, answers: Answers, workers: Workers) -> None:
        self._settings, self._answers, self._workers = settings, answers, workers
        self._frames = settings.dataset.sample_ids
        self._streams: dict[str, tuple[int, asyncio.Event]] = {}
        self._num_told = 0  # replaced workers

    async def setup(self, request: Request) -> Response:
        """Everything that the page offers to choose."""
        del request
        return JSONResponse(page_setup(self._settings.title, self._frames))

    async def scene(self, request: Request) -> Response:
        """The broken sensors' data, without pictures."""
        answer = await self._answers.part("scene", self._state(request))
        return JSONResponse(answer.content)

    async def file(self, request: Request) -> Response:
        """A picture, or packed points."""
        name = request.path_params["name"]
        if name not in _PARTS_OF_FILES:
            return _fault("there is no such picture", 404)
        answer = await self._answers.part(_PARTS_OF_FILES[name], self._state(request))
        if name not in answer.files:
            return _fault(f"there is no {name} for this state", 404)
        if name == "points":  # packed by the worker
            zipped = {"Content-Encoding": "gzip"}
            return Response(answer.files[name], 200, zipped, "application/octet-stream")
        return Response(answer.files[name], media_type="image/jpeg")

    async def commands(self, request: Request) -> Response:
        """Commands that reproduce a state."""
        state = self._state(request)
        text = reproducing_commands(
            state, self._settings.data, self._settings.dataset, self._settings.engine
        )
        return JSONResponse({"commands": text, "query": state.to_query()})

    async def answers(self, request: Request) -> Response:
        """All parts as they come, as server-sent events; ends the client's older answers."""
        state = self._state(request)
        return self._stream(request, self._answer_events(state))

    async def timeline(self, request: Request) -> Response:
        """Health along the drive, frame by frame, as server-sent events."""
        state = self._state(request)
        return self._stream(request, health_along(self._answers, state, self._frames))

    def _state(self, request: Request) -> PageState:
        return parse_state(request.url.query, self._frames)

    async def _answer_events(self, state: PageState) -> AsyncGenerator[tuple[str, Any]]:
        async with aclosing(self._answers.parts(state)) as parts:
            async for name, answer in parts:
                if self._workers.num_replaced > self._num_told:
                    self._num_told = self._workers.num_replaced
                    yield "notice", "a worker process had ended and was started again"
                if isinstance(answer, ValueError):
                    yield "fault", {"part": name, "reason": plain_line(str(answer))}
                else:
                    content = {**answer.content, "files": sorted(answer.files)}
                    yield "part", {"part": name, **content}

    def _stream(self, request: Request, events: AsyncGenerator[tuple[str, Any]]) -> Response:
        client = request.query_params.get("client", "")[:64]
        given = request.query_params.get("turn", "")[:12]
        turn = int(given) if given.isdecimal() else 0
        last, older = self._streams.get(client, (0, None))
        if turn < last:  # requests may overtake each other
            return Response(_event("cancelled", {}), media_type="text/event-stream")
        if older is not None:
            older.set()
            del self._streams[client]
        if len(self._streams) >= MAX_STREAMS:
            return _fault(f"{MAX_STREAMS} pages ask already; close some", 503)
        ended = asyncio.Event()
        self._streams[client] = turn, ended

        async def lines() -> AsyncIterator[bytes]:
            try:
                async for name, content in _until(events, ended):
                    yield _event(name, content)
                yield _event("cancelled" if ended.is_set() else "done", {})
            finally:
                if self._streams.get(client) == (turn, ended):
                    del self._streams[client]

        headers = {"Cache-Control": "no-store"}
        return StreamingResponse(lines(), media_type="text/event-stream", headers=headers)


async def _until(
    events: AsyncGenerator[tuple[str, Any]], ended: asyncio.Event
) -> AsyncGenerator[tuple[str, Any]]:
    """Yield events until there is none or a newer request has ended these."""
    end = asyncio.create_task(ended.wait())
    following = asyncio.ensure_future(anext(events))
    try:
        while True:
            await asyncio.wait((end, following), return_when=asyncio.FIRST_COMPLETED)
            if end.done():
                return
            try:
                event = following.result()
            except StopAsyncIteration:
                return
            following = asyncio.ensure_future(anext(events))
            yield event
    finally:
        end.cancel()
        following.cancel()
        closing = asyncio.create_task(_close(events, following))
        _CLOSING.add(closing)
        closing.add_done_callback(_CLOSING.discard)


async def _close(events: AsyncGenerator[Any], following: "asyncio.Future[Any]") -> None:
    """Close a generator whose next event is no longer waited for."""
    await asyncio.wait((following,))
    await events.aclose()


def _event(name: str, content: object) -> bytes:
    return f"event: {name}\ndata: {json.dumps(content, separators=(',', ':'))}\n\n".encode()


def _of_page(
    answer: Callable[[_Page, Request], Awaitable[Response]],
) -> Callable[[Request], Awaitable[Response]]:
    """Endpoint of a method of the running page."""

    async def endpoint(request: Request) -> Response:
        return await answer(request.app.state.page, request)

    return endpoint


async def _static_file(request: Request) -> Response:
    """A file of the package; only names listed there exist."""
    name = request.path_params.get("name", "index.html")
    found = {each.name: each for each in _STATIC.iterdir()}.get(name)
    if found is None:
        return _fault("there is no such page", 404)
    kind = mimetypes.guess_type(name)[0] or "text/plain"
    return Response(found.read_bytes(), media_type=kind, headers={"Cache-Control": "no-cache"})


async def _on_value_error(request: Request, error: Exception) -> Response:
    del request
    return _fault(plain_line(str(error)), 422)


def _fault(reason: str, status: int) -> Response:
    return JSONResponse({"reason": reason}, status)
