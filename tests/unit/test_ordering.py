"""The order of Cuthill and McKee, on graphs of all kinds."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ebb.relations.cuthill_mckee import THIN, Graph, cuthill_mckee, graph_of
from ebb.relations.sorting import stable_order


def lattice(*shape: int) -> tuple[np.ndarray, np.ndarray]:
    """The links between neighbours of a lattice, each once."""
    rows = np.arange(np.prod(shape)).reshape(shape)
    pairs = [(np.delete(rows, -1, axis), np.delete(rows, 0, axis)) for axis in range(len(shape))]
    return np.concatenate([a.ravel() for a, _ in pairs]), np.concatenate([b.ravel() for _, b in pairs])


def shuffled(size: int, links: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    places = np.random.default_rng(size).permutation(size)
    return places[links[0]], places[links[1]]


def bandwidth(order: np.ndarray, links: tuple[np.ndarray, np.ndarray]) -> int:
    rank = np.empty_like(order)
    rank[order] = np.arange(order.size)
    return int(np.abs(rank[links[0]] - rank[links[1]]).max(initial=0))


def ordered(size: int, links: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    order = cuthill_mckee(graph_of(size, [links]))
    assert np.array_equal(np.sort(order), np.arange(size))
    return order


@given(st.integers(0, 60), st.data())
def test_every_row_is_placed_once_and_components_stay_together(size: int, data: st.DataObject) -> None:
    keys = st.integers(-1, size - 1)
    links = data.draw(st.lists(st.tuples(keys, keys), max_size=80)) if size else []
    pairs = np.array(links, dtype=np.int32).reshape(-1, 2)
    order = ordered(size, (pairs[:, 0], pairs[:, 1]))
    components = {row: {row} for row in range(size)}
    for a, b in links:
        if a >= 0 and b >= 0:
            merged = components[a] | components[b]
            components.update(dict.fromkeys(merged, merged))
    place = {int(row): position for position, row in enumerate(order)}
    for component in components.values():
        positions = [place[row] for row in component]
        assert max(positions) - min(positions) == len(component) - 1


@given(st.lists(st.integers(-1, 200_000), max_size=60), st.sampled_from([np.int32, np.int64]))
def test_keys_sort_as_numpy_sorts_them(keys: list[int], dtype: type) -> None:
    array = np.array(keys, dtype=dtype)
    assert np.array_equal(stable_order(array), np.argsort(array, kind="stable"))


def test_keys_of_more_than_32_bits_sort() -> None:
    array = np.array([2**40, -1, 2**40 - 1, 5, 2**33, 5], dtype=np.int64)
    assert stable_order(array).tolist() == [1, 3, 5, 4, 2, 0]


@pytest.mark.parametrize("shape", [(400,), (THIN - 2, 90), (THIN + 2, 90), (12, 13, 14), (1, 1)], ids=str)
def test_lattices_get_the_bandwidth_of_scipy(shape: tuple[int, ...]) -> None:
    csgraph = pytest.importorskip("scipy.sparse.csgraph")
    sparse = pytest.importorskip("scipy.sparse")
    size = int(np.prod(shape))
    links = shuffled(size, lattice(*shape))
    matrix = sparse.csr_matrix((np.ones(len(links[0])), links), shape=(size, size))
    theirs = csgraph.reverse_cuthill_mckee(matrix + matrix.T, symmetric_mode=True)
    assert bandwidth(ordered(size, links), links) <= 1.2 * bandwidth(theirs, links)


def test_random_graphs_get_about_the_bandwidth_of_scipy() -> None:
    csgraph = pytest.importorskip("scipy.sparse.csgraph")
    sparse = pytest.importorskip("scipy.sparse")
    rng = np.random.default_rng(5)
    links = rng.integers(0, 3000, 4000), rng.integers(0, 3000, 4000)
    matrix = sparse.csr_matrix((np.ones(len(links[0])), links), shape=(3000, 3000))
    theirs = csgraph.reverse_cuthill_mckee(matrix + matrix.T, symmetric_mode=True)
    assert bandwidth(ordered(3000, links), links) <= 1.2 * bandwidth(theirs, links)


def test_a_path_is_followed_from_one_end() -> None:
    links = shuffled(5000, lattice(5000))
    assert bandwidth(ordered(5000, links), links) == 1


@pytest.mark.parametrize("leaves", [3, 5000])
def test_leaves_of_a_star_surround_it(leaves: int) -> None:
    links = shuffled(leaves + 1, (np.zeros(leaves, dtype=np.int64), np.arange(1, leaves + 1)))
    assert int(np.flatnonzero(ordered(leaves + 1, links) == links[0][0])[0]) == 1


def test_many_components_are_searched_at_once() -> None:
    first = np.arange(0, 30_000, 3)
    links = shuffled(30_000, (np.concatenate((first, first + 1)), np.concatenate((first + 1, first + 2))))
    assert bandwidth(ordered(30_000, links), links) == 1


def test_rows_without_links_come_last_as_they_were() -> None:
    assert ordered(6, (np.array([4, -1, 2]), np.array([1, 3, 2]))).tolist()[2:] == [0, 2, 3, 5]


def test_links_given_from_both_ends_are_taken_once() -> None:
    a, b = lattice(5)
    one, both = graph_of(5, [(a, b)]), graph_of(5, [(np.append(a, b), np.append(b, a))])
    for graph in (one, both):
        assert graph.degrees.tolist() == [1, 2, 2, 2, 1]
        assert sorted(graph.neighbours[graph.offsets[1] : graph.offsets[2]].tolist()) == [0, 2]


def test_no_rows() -> None:
    assert ordered(0, (np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64))).size == 0
    assert isinstance(graph_of(3, []), Graph)
    assert cuthill_mckee(graph_of(3, [])).tolist() == [0, 1, 2]
