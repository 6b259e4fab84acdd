import asyncio

import pytest

from sightline.app.answers import Answers
from sightline.app.parts import Answer
from sightline.app.state import parse_state

FRAMES = ("000000", "000001")
SOUND = parse_state("", FRAMES)
FOG = parse_state("fault=lidar_fog.3.0", FRAMES)
BEST_2D = parse_state("detection2d=detection2d-best", FRAMES)


class Recorder:
    """Stands for the workers: records the tasks, and answers when it is let."""

    def __init__(self, size=1000):
        self.tasks, self.dropped, self.go = [], [], asyncio.Event()
        self.size = size

    async def run(self, task):
        self.tasks.append(task)
        try:
            await self.go.wait()
        except asyncio.CancelledError:
            self.dropped.append(task.part)
            raise
        return Answer(content={"by": task.part}, found=b"x" * self.size)


def names(workers):
    return [task.part for task in workers.tasks]


def test_what_several_wait_for_is_computed_once_and_kept():
    async def run():
        workers = Recorder()
        answers = Answers(workers.run)
        waiting = [asyncio.create_task(answers.part("detection2d", SOUND)) for _ in range(3)]
        await asyncio.sleep(0)
        workers.go.set()
        assert len({id(each) for each in await asyncio.gather(*waiting)}) == 1
        await answers.part("detection2d", SOUND)
        assert names(workers) == ["detection2d"]
        await answers.part("detection2d", FOG)
        assert names(workers) == ["detection2d"] * 2

    asyncio.run(run())


def test_weights_of_another_task_change_no_answer():
    async def run():
        workers = Recorder()
        workers.go.set()
        answers = Answers(workers.run)
        for state in (SOUND, BEST_2D):
            for part in ("scene", "health", "detection2d", "detection3d", "joined"):
                await answers.part(part, state)
        assert sorted(names(workers)) == sorted(
            ["scene", "health", "detection3d", *["detection2d", "joined"] * 2]
        )

    asyncio.run(run())


def test_objects_are_joined_from_both_detectors_detections():
    async def run():
        workers = Recorder()
        workers.go.set()
        await Answers(workers.run).part("joined", SOUND)
        assert names(workers)[-1] == "joined"
        assert workers.tasks[-1].found == (b"x" * 1000, b"x" * 1000)

    asyncio.run(run())


def test_what_nobody_waits_for_any_more_is_cancelled_and_what_another_waits_for_is_not():
    async def run():
        workers = Recorder()
        answers = Answers(workers.run)
        one, other = (asyncio.create_task(answers.part("health", SOUND)) for _ in range(2))
        await asyncio.sleep(0.01)
        one.cancel()
        await asyncio.sleep(0.01)
        assert workers.dropped == []
        other.cancel()
        await asyncio.sleep(0.01)
        assert workers.dropped == ["health"]

    asyncio.run(run())


def test_who_asks_again_while_an_abandoned_computation_ends_gets_a_new_one():
    async def run():
        workers = Recorder()
        answers = Answers(workers.run)
        older = asyncio.create_task(answers.part("health", SOUND))
        await asyncio.sleep(0.01)
        older.cancel()
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        workers.go.set()
        assert (await answers.part("health", SOUND)).content == {"by": "health"}

    asyncio.run(run())


def test_a_stream_that_is_closed_cancels_its_parts():
    async def run():
        workers = Recorder()
        parts = Answers(workers.run).parts(SOUND)
        waiting = asyncio.create_task(anext(parts))
        await asyncio.sleep(0.01)
        waiting.cancel()
        await asyncio.sleep(0.02)
        assert sorted(workers.dropped) == [
            "depth-completion", "detection2d", "detection3d", "health",
        ]  # fmt: skip

    asyncio.run(run())


def test_the_memory_of_kept_answers_is_bounded_and_the_oldest_goes_first():
    async def run():
        workers = Recorder(size=10_000)
        workers.go.set()
        answers = Answers(workers.run, max_bytes=25_000)
        for part in ("health", "detection2d", "detection3d"):
            await answers.part(part, SOUND)
        await answers.part("detection3d", SOUND)
        assert names(workers) == ["health", "detection2d", "detection3d"]
        await answers.part("health", SOUND)
        assert names(workers)[-1] == "health"

    asyncio.run(run())


def test_an_error_is_not_kept():
    class Failing(Recorder):
        async def run(self, task):
            self.tasks.append(task)
            raise ValueError("damaged")

    async def run():
        workers = Failing()
        answers = Answers(workers.run)
        for _ in range(2):
            with pytest.raises(ValueError, match="damaged"):
                await answers.part("scene", SOUND)
        assert len(workers.tasks) == 2

    asyncio.run(run())
