"""What outlasts a browser and what does not wait for an image: recordings, clicks."""

import globule as gb
import numpy as np
import pytest
from viewer_helpers import Watched, blob, until

pytest.importorskip("websockets")

from globule.viewer import sequence_source
from globule.viewer.state import State


@pytest.fixture
def opened():
    with Watched(blob(300)) as watched:
        yield watched.viewer, watched.program(answers=False)


def test_a_recording_outlasts_its_tab(opened, tmp_path, folder):
    av = pytest.importorskip("av")
    viewer, program = opened
    save = next(panel for panel in viewer.page.panels if type(panel).__name__ == "Save")
    save.size.value = "64x48"
    program.command("Record")
    until(lambda: save._recorders, "for the recording")
    (recorder, *_) = next(iter(save._recorders.values()))
    until(lambda: recorder.n_pictures, "for an image")
    program.close()  # the tab
    until(lambda: list(tmp_path.glob("movie-*.mp4")), "for the movie")
    (movie,) = tmp_path.glob("movie-*.mp4")
    with av.open(str(movie)) as file:
        assert sum(1 for _ in file.decode(video=0)) > 0
    until(lambda: not viewer.clients)
    assert not save._recorders


@pytest.mark.parametrize(
    "lost", [False, pytest.param(True, marks=pytest.mark.slow)], ids=["stopped", "first request lost"]
)
def test_a_click_does_not_wait_for_a_long_image(opened, lost):
    """The image in progress is stopped; otherwise the answer would come after the image."""
    viewer, program = opened
    client, engine = program.client, viewer.engine
    client.sink.send = lambda number, data, plan: client.acknowledge(number)
    client.acknowledge(1000)
    until(lambda: client.frame is not None, "for the first image")
    viewer.state.set(quality__samples=64)
    client.pacer.scale = 0.1  # of the moving image, which comes first
    program.ask("size", [3000, 2250])
    until(lambda: engine._still is not None and client.pacer.full[0] == 3000, "for a long image")
    with engine.wake:
        core, cancelled = engine._still[1], []

        class Scene:
            def cancel(self):
                cancelled.append(1)
                if not lost or len(cancelled) > 3:
                    core.cancel()

        engine._still = client, Scene()
    found = program.hand.pick((0.5, 0.5))
    assert cancelled
    assert client.frame.samples < 64  # answered before the image was complete
    assert found is not None
    camera = client.camera
    ray = np.subtract(found.position, camera.eye)
    towards = np.subtract(camera.look_at, camera.eye)
    assert np.dot(ray, towards) / np.linalg.norm(ray) / np.linalg.norm(towards) > 0.99
    program.ask("size", [60, 45])  # for a quick end
    until(lambda: client.pacer.full[0] == 60)


def test_a_long_sequence_keeps_only_so_many_frames(tmp_path, monkeypatch):
    frame = gb.Particles(np.zeros((1000, 3)), support=0.1)
    read, broken = [], {"7.npz"}

    def read_frame(name):
        read.append(name)
        if name in broken:
            raise ValueError(f"{name}: damaged")
        return frame[:]

    one = sequence_source._bytes(frame)
    monkeypatch.setattr(sequence_source, "KEPT_BYTES", 10 * one)
    source = sequence_source.SequenceSource("long", [f"{i}.npz" for i in range(200)], read_frame=read_frame)
    try:
        state = State()
        for i in [*range(1, 60), *range(150, 40, -1)]:
            state.set(time__frame=i)
            if i == 7:
                with pytest.raises(ValueError, match="damaged"):
                    source.advance(state)
                broken.clear()  # the file is whole again
                state.set(time__frame=i)
            assert source.advance(state) is not None
            assert source.frame == i
            assert len(source._kept) <= 16  # one is shown, three are read ahead
            assert sum(source._sizes.values()) <= 11 * one
        before = len(read)
        state.set(time__frame=42)
        source.advance(state)
        assert len(read) <= before + 3  # at most those behind it: 42 itself is kept
        assert set(source._sizes) <= set(source._kept)
    finally:
        source.close()
