"""The checkpoint of a run: whenever it is cut off, the blocks before are recovered."""

import hashlib
import json
import struct
import tracemalloc
import zlib
from dataclasses import asdict, fields, replace
from pathlib import Path

import numpy as np
import pytest

from cageik_cli.geometry.frames import Block
from cageik_cli.geometry.rotations import nearest_rotations_by_svd
from cageik_cli.method.solve.blocks import KeptBlock, SolvedBlock, make_solved_block
from cageik_cli.method.solve.dual_laplacian import Solution
from cageik_cli.method.solve.metrics import (
    DeviationPeaks,
    FrameMetrics,
    KeptMetrics,
    leave_gaps,
)
from cageik_cli.method.solve.summary import summarize_blocks
from cageik_cli.store.checkpoint import (
    CHECKPOINT_MAGIC,
    Checkpoint,
    RunSpec,
    checkpoint_progress,
    delete_checkpoint,
    from_bytes,
    is_checkpoint,
    to_bytes,
)
from cageik_cli.util.errors import CheckpointError, FormatError, InputError, OutputError
from cageik_cli.util.files import open_locked
from cageik_cli.util.messages import Hint
from tests.refusals import refused

SPEC = RunSpec(
    frames=[f"frame_{k}_é.obj" for k in range(5)],
    settings={"alpha": 0.5, "vertex_weights": False},
    sources={"cage": {"name": "cage.obj", "sha256": "ab"}},
    key="00",
    fit="",
    vertices=6,
    cage_vertices=4,
    block_frames=2,
    sampled_vertices=5,
    weighs_frames=False,
)


def block_of(start, count, faults=()):
    generator = np.random.default_rng(start)
    columns = {field.name: generator.uniform(1, 2, count) for field in fields(FrameMetrics)}
    columns["worst_vertex"] = np.arange(count)
    digests = tuple(bytes([start + k]) * 32 for k in range(count))
    cages = generator.normal(size=(count, 4, 3))
    rotations = nearest_rotations_by_svd(generator.normal(size=(count, 3, 3)))
    gaps = np.array([k - start for k in dict(faults)], np.int64)
    cages[gaps] = rotations[gaps] = np.nan
    squares = generator.uniform(1, 2, 6)
    peaks = DeviationPeaks(generator.uniform(1, 2, 6), generator.integers(start, start + count, 6))
    return SolvedBlock(
        start=start,
        cages=cages,
        rotations=rotations,
        metrics=leave_gaps(FrameMetrics(**columns), gaps),
        squared_errors=squares,
        peaks=peaks,
        digests=digests,
        skipped=dict(faults),
        sampled=generator.normal(size=(5, 3 * count)).astype(np.float32),
    )


BLOCKS = [
    block_of(0, 2),
    block_of(2, 2, {3: "frame_3: not a mesh ü; " + Hint("missing", True)}),
    block_of(4, 1),
]


def assert_same(found, expected):
    assert (found.start, found.stop) == (expected.start, expected.stop)
    assert (found.digests, found.skipped) == (expected.digests, expected.skipped)
    assert list(map(repr, found.skipped.values())) == list(map(repr, expected.skipped.values()))
    np.testing.assert_array_equal(found.cages, expected.cages)
    np.testing.assert_array_equal(found.squared_errors, expected.squared_errors)
    np.testing.assert_array_equal(found.peaks.deviations, expected.peaks.deviations)
    np.testing.assert_array_equal(found.peaks.frames, expected.peaks.frames)
    np.testing.assert_array_equal(found.rotations, expected.rotations)
    np.testing.assert_array_equal(found.sampled, expected.sampled)
    for field in fields(FrameMetrics):
        one, other = (getattr(block.metrics, field.name) for block in (found, expected))
        np.testing.assert_array_equal(one, other)


@pytest.fixture
def log(tmp_path):
    """The path of a log that holds all blocks."""
    path = tmp_path / "cages.h5.partial"
    checkpoint = Checkpoint.open(path, SPEC, resume=False)
    for block in BLOCKS:
        checkpoint.append(block)
    checkpoint.close()
    return path


def resume(path, is_current=lambda block: True):
    """Open the checkpoint as a run does that continues."""
    checkpoint = Checkpoint.open(path, SPEC, resume=True)
    checkpoint.recover(is_current)
    return checkpoint


def held(path):
    """What a run that continues finds."""
    checkpoint = resume(path)
    blocks = list(checkpoint.blocks())
    done = checkpoint.frames_done
    assert checkpoint.count_frames() == done
    checkpoint.close()
    return done, blocks


@pytest.mark.parametrize("block", BLOCKS)
def test_a_block_is_read_from_its_bytes(block):
    assert_same(from_bytes(to_bytes(block), SPEC), block)


def test_all_blocks_are_recovered(log):
    done, blocks = held(log)
    assert done == 5
    for found, expected in zip(blocks, BLOCKS, strict=True):
        assert_same(found, expected)
    assert checkpoint_progress(log) == (5, 5)
    assert is_checkpoint(log)


def test_a_checkpoint_cut_anywhere_keeps_the_complete_blocks(log):
    data = log.read_bytes()
    ends = []
    for count in range(len(BLOCKS) + 1):
        log.unlink()
        checkpoint = Checkpoint.open(log, SPEC, resume=False)
        for block in BLOCKS[:count]:
            checkpoint.append(block)
        checkpoint.close()
        ends.append(log.stat().st_size)
    frames = (0, 2, 4, 5)
    for size in range(0, len(data) + 1, 13):
        log.write_bytes(data[:size])
        whole = sum(end <= size for end in ends[1:])
        done, blocks = held(log)
        assert (done, len(blocks)) == (frames[whole], whole)
        assert log.stat().st_size == ends[whole]


def test_a_block_appended_after_a_cut_restores_the_bytes(log):
    data = log.read_bytes()
    log.write_bytes(data[:-20])
    checkpoint = resume(log)
    assert checkpoint.frames_done == 4
    checkpoint.append(BLOCKS[2])
    checkpoint.close()
    assert log.read_bytes() == data


@pytest.mark.parametrize("place", [-1, -300, -600])
def test_a_flipped_bit_ends_the_checkpoint_before_its_block(log, place):
    data = bytearray(log.read_bytes())
    data[place] ^= 1
    log.write_bytes(data)
    done, _ = held(log)
    assert done < 5


def test_outdated_blocks_are_cut_off(log):
    seen = []

    def is_current(block):
        seen.append(block.start)
        return block.start != 2

    checkpoint = resume(log, is_current)
    assert seen == [0, 2]
    assert checkpoint.frames_done == checkpoint.count_frames() == 2
    checkpoint.append(BLOCKS[1])
    assert [block.start for block in checkpoint.blocks()] == [0, 2]
    checkpoint.close()
    assert checkpoint_progress(log) == (4, 5)


def test_an_error_while_blocks_are_compared_cuts_nothing_off(log):
    data = log.read_bytes()

    def is_current(block):
        if block.start == 2:
            raise ValueError("unreadable")
        return True

    checkpoint = Checkpoint.open(log, SPEC, resume=True)
    with pytest.raises(ValueError, match="unreadable"):
        checkpoint.recover(is_current)
    assert (checkpoint.frames_done, checkpoint.count_frames()) == (2, 5)
    checkpoint.close()
    assert log.read_bytes() == data


def test_blocks_that_were_not_recovered_do_not_follow_new_ones(log):
    checkpoint = Checkpoint.open(log, SPEC, resume=True)
    assert (checkpoint.frames_done, checkpoint.count_frames()) == (0, 5)
    checkpoint.append(BLOCKS[0])
    assert checkpoint.count_frames() == 2
    checkpoint.close()
    assert checkpoint_progress(log) == (2, 5)


@pytest.mark.parametrize("kept", range(len(BLOCKS) + 1))
def test_the_summary_does_not_depend_on_interruptions(log, kept):
    expected = summarize_blocks(BLOCKS)
    checkpoint = resume(log, lambda block: block.start < 2 * kept)
    for block in BLOCKS[kept:]:
        checkpoint.append(block)
    found = checkpoint.summary
    checkpoint.close()
    assert (found.skipped, found.digests) == (expected.skipped, expected.digests)
    np.testing.assert_array_equal(found.vertex_rms, expected.vertex_rms)
    np.testing.assert_array_equal(found.find_key_frames(), expected.find_key_frames())
    np.testing.assert_array_equal(found.peaks.deviations, expected.peaks.deviations)
    np.testing.assert_array_equal(found.peaks.frames, expected.peaks.frames)


def test_blocks_are_read_once_to_be_recovered_and_once_to_be_composed(log, monkeypatch):
    reads = []

    def count(data, spec):
        reads.append(len(data))
        return from_bytes(data, spec)

    monkeypatch.setattr("cageik_cli.store.checkpoint.from_bytes", count)
    checkpoint = resume(log)
    assert len(reads) == 3
    list(checkpoint.blocks())
    assert len(reads) == 6
    checkpoint.close()


def test_a_checkpoint_written_by_another_run_is_not_replaced(log):
    data = log.read_bytes()
    with pytest.raises(CheckpointError, match=r"cages\.h5\.partial: .*`resume=True`"):
        Checkpoint.open(log, SPEC, resume=False)
    assert log.read_bytes() == data


def test_overwrite_starts_a_new_checkpoint(log):
    checkpoint = Checkpoint.open(log, SPEC, resume=False, overwrite=True)
    assert (checkpoint.frames_done, list(checkpoint.blocks())) == (0, [])
    checkpoint.close()
    assert checkpoint_progress(log) == (0, 5)


@pytest.mark.parametrize(
    ("other", "says"),
    [
        (replace(SPEC, frames=["a", "b"]), r"it was of 5 other frames, \S+ to "),
        (replace(SPEC, settings=SPEC.settings | {"alpha": 0.25}), "it was run with `alpha=0.5`; "),
        (
            replace(SPEC, settings=SPEC.settings | {"missing": True, "robust": False}),
            "it was run without `missing=`, without `robust=`; ",
        ),
        (replace(SPEC, sources={}), "with another cage"),
        (
            replace(SPEC, sources=SPEC.sources | {"vertex_weights": {}}),
            "with another vertex weights",
        ),
        (replace(SPEC, version="0.0"), "it was of cageik"),
        (replace(SPEC, key="01"), "its weights were others"),
        (replace(SPEC, cage_vertices=5), "its weights were others"),
    ],
)
def test_a_checkpoint_of_another_spec_is_refused_and_kept(log, other, says):
    data = log.read_bytes()
    with pytest.raises(CheckpointError, match=rf"cages\.h5\.partial: .*{says}"):
        Checkpoint.open(log, other, resume=True)
    assert log.read_bytes() == data


def test_blocks_of_weights_that_were_fitted_to_other_frames_are_cut_off(log):
    checkpoint = Checkpoint.open(log, replace(SPEC, fit="02"), resume=True)
    assert checkpoint.has_other_fit
    assert checkpoint.spec.fit == "02"
    checkpoint.close()
    assert checkpoint_progress(log) == (0, 5)


@pytest.mark.parametrize("version", [b"1", b"9"])
def test_a_checkpoint_of_an_earlier_version_is_known_as_one(tmp_path, version):
    path = tmp_path / "cages.h5.partial"
    path.write_bytes(b"cageik.partial " + version + b"\n" + bytes(99))
    assert is_checkpoint(path)
    for read in (checkpoint_progress, delete_checkpoint):
        with pytest.raises(CheckpointError, match=r"cages\.h5\.partial: .*another version"):
            read(path)


def test_a_file_that_is_not_a_checkpoint_is_refused_and_kept(tmp_path):
    path = tmp_path / "cages.h5.partial"
    path.write_text("my diary")
    assert not is_checkpoint(path)
    with pytest.raises(FormatError, match=r"cages\.h5\.partial"):
        Checkpoint.open(path, SPEC, resume=True)
    with pytest.raises(FormatError, match=r"cages\.h5\.partial"):
        checkpoint_progress(path)
    assert path.read_text() == "my diary"


@pytest.mark.parametrize("head", [b"", b"ab 12\n", b"ab 99999999999999\n{}", b"ab x\n", b"\n"])
def test_a_spec_that_is_cut_short_is_no_progress(tmp_path, head):
    path = tmp_path / "a.partial"
    path.write_bytes(CHECKPOINT_MAGIC + head)
    assert checkpoint_progress(path) == (0, 0)
    assert held(path)[0] == 0


def test_two_runs_cannot_open_one_checkpoint(log):
    checkpoint = Checkpoint.open(log, SPEC, resume=True)
    with pytest.raises(CheckpointError, match=r"cages\.h5\.partial"):
        Checkpoint.open(log, SPEC, resume=True)
    checkpoint.discard()
    assert not log.exists()
    Checkpoint.open(log, SPEC, resume=True).close()


def test_a_file_deleted_while_it_is_opened_is_created_again(tmp_path, monkeypatch):
    path = tmp_path / "a.partial"
    path.write_text("of a run that ends just now")
    seen = []
    lstat = Path.lstat

    def ends(self):
        if not seen:
            path.unlink()
        seen.append(self)
        return lstat(self)

    monkeypatch.setattr(Path, "lstat", ends)
    with open_locked(path) as file:
        assert file.read() == b""
    assert len(seen) == 2


def test_a_checkpoint_that_cannot_be_written_is_an_output_error(tmp_path):
    with pytest.raises(OutputError, match=r"cages\.h5\.partial: .*No such file"):
        Checkpoint.open(tmp_path / "nowhere" / "cages.h5.partial", SPEC, resume=True)


def test_a_block_that_cannot_be_written_keeps_those_before(log, monkeypatch):
    checkpoint = resume(log, lambda block: block.start < 4)

    def full(file, data):
        file.write(data[: len(data) // 2])
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("cageik_cli.store.checkpoint._write_all", full)
    with pytest.raises(OutputError, match="No space left on device"):
        checkpoint.append(BLOCKS[2])
    monkeypatch.undo()
    checkpoint.append(BLOCKS[2])
    checkpoint.close()
    assert held(log)[0] == 5


def test_an_unreadable_frame_becomes_a_gap():
    block = block_of(2, 3)
    read = Block(2, np.zeros((3, 1, 3)), {3: InputError("frame_3: missing")})
    squares = np.array([[1.0, 2.0], [10.0, 10.0], [3.0, 5.0]])
    solution = Solution(block.cages, block.rotations, np.zeros((3, 1, 3)), block.sampled)
    found = make_solved_block(read, solution, block.metrics, squares, block.digests)
    assert np.isnan(found.rotations[1]).all()
    assert found.sampled[:, 3:6].tolist() == [[0, 0, 0]] * 5
    np.testing.assert_array_equal(found.sampled[:, :3], block.sampled[:, :3])
    np.testing.assert_array_equal(found.squared_errors, [4.0, 7.0])
    np.testing.assert_array_equal(found.peaks.deviations, np.sqrt([3.0, 5.0]))
    assert found.peaks.frames.tolist() == [4, 4]
    assert found.skipped == {3: "frame_3: missing"}
    assert np.isnan(found.cages[1]).all()
    assert np.isnan(found.metrics.rms[1])
    assert found.metrics.worst_vertex.tolist() == [0, -1, 2]
    np.testing.assert_array_equal(found.cages[[0, 2]], block.cages[[0, 2]])
    assert np.isfinite(block.cages).all()


def test_a_deleted_checkpoint_can_be_discarded(log):
    checkpoint = Checkpoint.open(log, SPEC, resume=True)
    log.unlink()
    checkpoint.discard()
    assert not log.exists()


def test_the_checkpoint_of_another_run_is_not_discarded(log):
    checkpoint = Checkpoint.open(log, SPEC, resume=True)
    log.unlink()
    log.write_bytes(b"of another run")
    checkpoint.discard()
    assert log.read_bytes() == b"of another run"


def test_a_checkpoint_is_deleted_unless_another_run_writes_it(log):
    mine = open_locked(log)
    delete_checkpoint(log)
    assert log.exists()
    mine.close()
    delete_checkpoint(log)
    assert not log.exists()
    delete_checkpoint(log)
    log.write_text("a novel")
    with pytest.raises(FormatError, match=r"cages\.h5\.partial"):
        delete_checkpoint(log)
    assert log.read_text() == "a novel"


def write_with_checksums(path, spec, blocks):
    """Write a checkpoint of any content, with its digest and checksums."""
    text = spec if isinstance(spec, bytes) else json.dumps(spec).encode()
    head = CHECKPOINT_MAGIC + f"{hashlib.sha256(text).hexdigest()} {len(text)}\n".encode() + text
    framed = [struct.pack("<QI", len(data), zlib.crc32(data)) + data for data in blocks]
    path.write_bytes(b"".join([head, *framed]))


def header(place, number):
    """Put a number into the header of a block."""

    def change(data):
        struct.pack_into("<Q", data, 8 * place, number)

    return change


def reasons(text):
    """Put other reasons for skipped frames into a block, and their length into its header."""

    def change(data):
        old = struct.unpack_from("<Q", data, 24)[0]
        data[len(data) - old :] = text
        struct.pack_into("<Q", data, 24, len(text))

    return change


@pytest.mark.parametrize(
    "change",
    [
        *(header(place, number) for place in range(5) for number in (3, 2**62, 2**64 - 1)),
        header(1, 0),
        lambda data: data.__delitem__(slice(30, None)),
        lambda data: data.__delitem__(slice(90, None)),
        lambda data: data.extend(bytes(8)),
        *map(reasons, (b"{", b"[]", b"5", b"\xff", b"[" * 100_000, b'{"a": "b"}', b'{"9": "c"}')),
    ],
)
def test_a_block_that_is_not_what_its_header_says_ends_the_checkpoint(log, change):
    """Its checksum is right: it was written to be wrong."""
    second = bytearray(to_bytes(BLOCKS[1]))
    change(second)
    write_with_checksums(log, asdict(SPEC), [to_bytes(BLOCKS[0]), second, to_bytes(BLOCKS[2])])
    tracemalloc.start()
    assert checkpoint_progress(log) == (2, 5)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1 << 22
    assert held(log)[0] == 2


def put(array, value, place=0):
    """A copy with another value at a place."""
    found = np.array(array)
    found.flat[place] = value
    return found


def put_metric(name, value):
    return lambda block: {
        "metrics": replace(block.metrics, **{name: put(getattr(block.metrics, name), value)})
    }


@pytest.mark.parametrize(
    "change",
    [
        *(
            lambda block, name=name, value=value: {name: put(getattr(block, name), value)}
            for name, value in (
                ("cages", np.nan),
                ("cages", 1e300),
                ("rotations", 2.0),
                ("rotations", np.nan),
                ("squared_errors", -1.0),
                ("squared_errors", np.inf),
                ("sampled", np.nan),
            )
        ),
        lambda block: {"rotations": -block.rotations},
        lambda block: {"skipped": {}},
        lambda block: {"skipped": {2: "of another frame", **block.skipped}},
        lambda block: {"peaks": replace(block.peaks, frames=put(block.peaks.frames, 4))},
        lambda block: {"peaks": replace(block.peaks, deviations=put(block.peaks.deviations, -1))},
        *(put_metric(name, -1) for name in ("rms", "max_deviation", "worst_vertex", "spread")),
        put_metric("worst_vertex", 6),
        put_metric("volume", np.inf),
    ],
)
def test_a_block_that_no_run_has_solved_is_refused(change):
    wrong = replace(BLOCKS[1], **change(BLOCKS[1]))
    with pytest.raises(ValueError, match="no solved block"):
        from_bytes(to_bytes(wrong), SPEC)


KEPT = KeptBlock(
    metrics=KeptMetrics(
        np.array([1, -1]), np.array([0, -1]), *np.ones((2, 2)), *np.full((2, 2), np.nan)
    ),
    starts=np.array([0, 2, 2]),
    vertices=np.array([1, 4]),
    weights=np.array([0.0, 0.5]),
    counts=np.array([1, 0, 1, 1, 1, 1]),
)


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("starts", [0, 1, 2**62]),
        ("starts", [0, 3, 2]),
        ("starts", [1, 2, 2]),
        ("vertices", [1, 6]),
        ("vertices", [-1, 4]),
        ("weights", [0, np.nan]),
        ("counts", [3, 0, 1, 1, 1, 1]),
        ("metrics", replace(KEPT.metrics, missing=np.array([7, -1]))),
        *(
            ("metrics", replace(KEPT.metrics, **{name: np.array([value, 1])}))
            for name, value in (("rms_kept", np.inf), ("rms_kept", np.nan), ("area_rms", -1))
        ),
    ],
)
def test_what_no_run_has_kept_is_refused(log, name, values):
    spec = replace(SPEC, weighs_frames=True)
    sound = replace(BLOCKS[1], kept=KEPT)
    assert from_bytes(to_bytes(sound), spec).kept.vertices.tolist() == [1, 4]
    found = values if name == "metrics" else np.array(values)
    wrong = to_bytes(replace(sound, kept=replace(KEPT, **{name: found})))
    with pytest.raises(ValueError, match=r"no solved block|entries"):
        from_bytes(wrong, spec)
    for held_spec, blocks in ((SPEC, [to_bytes(replace(BLOCKS[0], kept=KEPT))]), (spec, [wrong])):
        write_with_checksums(log, asdict(held_spec), blocks)
        assert checkpoint_progress(log) == (0, 5)


@pytest.mark.parametrize(
    "spec",
    [
        b"[" * 100_000,
        {**asdict(SPEC), "settings": json.loads('{"a":' * 17 + "1" + "}" * 17)},
        b"\xff",
        b"5",
        b"NaN",
        *(
            {**asdict(SPEC), name: value}
            for name, value in (
                ("frames", []),
                ("frames", 5),
                ("frames", ["a", 1]),
                ("settings", [1]),
                ("sources", None),
                ("key", 1),
                ("vertices", 0),
                ("cage_vertices", 4.0),
                ("block_frames", True),
                ("sampled_vertices", -1),
                ("weighs_frames", 0),
                ("version", None),
            )
        ),
    ],
)
def test_a_spec_of_no_run_is_not_a_checkpoint(log, spec):
    write_with_checksums(log, spec, [])
    for read in (checkpoint_progress, delete_checkpoint, resume):
        with refused(FormatError, "is not a checkpoint", at=log):
            read(log)
    assert log.exists()


def test_a_spec_with_other_fields_is_of_another_version(log):
    write_with_checksums(log, {"frames": []}, [])
    with refused(CheckpointError, "another version", at=log):
        checkpoint_progress(log)


@pytest.mark.parametrize("name", ["vertices", "cage_vertices", "block_frames", "sampled_vertices"])
def test_blocks_of_other_sizes_than_the_spec_says_are_damaged(log, name):
    write_with_checksums(log, asdict(replace(SPEC, **{name: 2**62})), map(to_bytes, BLOCKS))
    assert checkpoint_progress(log) == (0, 5)
