"""Random streams: one list names them, no two are alike, and nothing else is drawn from a seed with a key."""

import ast
from itertools import product

import numpy as np
import pytest

from optkit import scenario
from optkit.basics.seeds import Stream, seed_sequence, step_generator, stream
from tests.layers import ROOT


def state(sequence):
    """Return what a seed sequence is, as far as generators can tell."""
    return tuple(sequence.generate_state(4, np.uint64).tolist())


def test_no_two_streams_share_a_key():
    """All streams of all small seeds, what is spawned from them, samples, and exploration are different sources."""
    assert len({int(name) for name in Stream}) == len(Stream.__members__)
    found = []
    for seed, name in product(range(4), Stream):
        found += [state(stream(seed, name)), *(state(stream(seed, name, k)) for k in range(5))]
        found += [state(child) for k in range(2) for child in stream(seed, name, k).spawn(4)]
    streams = len(found)
    assert len(set(found)) == streams
    for seed in range(4):
        samples = [state(child) for child in seed_sequence(seed).spawn(40)]
        # A stream without a number of its own is never drawn from, only spawned from: its key is that of a sample.
        drawn = {state(stream(seed, name, k)) for name in Stream for k in range(5)}
        assert drawn.isdisjoint(samples)
        steps = [step_generator(seed, step).bit_generator.seed_seq for step in range(1, 30)]
        assert set(map(state, steps)).isdisjoint({*found, *samples, state(seed_sequence(seed))})


@pytest.mark.slow
def test_only_the_list_of_streams_makes_keys():
    """No other file of the kit makes a seed sequence with a key, or a generator of several numbers."""
    for path in ROOT.rglob("*.py"):
        if path.match("basics/seeds.py") or "teach" in path.parts:
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call):
                called = ast.unparse(node.func)
                assert not called.endswith("SeedSequence"), (path, node.lineno)
                assert not called.endswith("default_rng") or not isinstance(node.args[0], ast.List), (path, node.lineno)


def test_validation_instances_are_not_the_draws_of_charges():
    """A report whose seed is the world's charges with other draws than those that choose a training's round."""
    world = 3
    charges = state(stream(world, Stream.CHARGES, 2))
    validation = state(stream(world, Stream.FURTHER_VALIDATION).spawn(3)[2])
    assert charges != validation


@pytest.mark.slow
def test_streams_of_published_instances_stay():
    """Worlds and instances are those of the benchmark sets, whose datasheet prints their keys."""
    source = scenario("I.1", seed=5)
    again = [source.instance(np.random.SeedSequence(5, spawn_key=(1, k))) for k in range(2)]
    assert source.split().train[:2] == again
    assert state(stream(5, Stream.WORLD, 0)) == state(np.random.SeedSequence(5, spawn_key=(0, 0)))
