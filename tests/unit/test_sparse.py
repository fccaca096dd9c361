"""Fields as SciPy's matrices: the same memory, the right matrix, whatever the storage."""

from __future__ import annotations

import numpy as np
import pytest

import ebb
from ebb.domains import TetMesh

sparse = pytest.importorskip("scipy.sparse")
from scipy.sparse.linalg import spsolve  # noqa: E402


def laplacian(mesh: TetMesh, type_=ebb.mat3d) -> None:
    """A positive definite matrix on the edges of a mesh with self edges, its vertices numbered as they are."""
    edges = mesh.edges
    tail, head = edges.tail.to_numpy(), edges.head.to_numpy()
    block = np.array([(2, 0.3, 0.1), (0.3, 1, 0.2), (0.1, 0.2, 1.5)])
    weight = np.where(tail == head, np.bincount(tail)[tail] + 0.1 * tail, -1.0)
    edges.new_field("a", type_, init=weight[:, None, None] * block if type_.shape else weight)


def dense(mesh: TetMesh) -> np.ndarray:
    values = mesh.edges.a.to_numpy()
    if values.ndim == 1:
        values = values[:, None, None]
    n, k = mesh.vertices.size, values.shape[1]
    full = np.zeros((n, n, k, k))
    full[mesh.edges.tail.to_numpy(), mesh.edges.head.to_numpy()] = values
    return full.transpose(0, 2, 1, 3).reshape(n * k, n * k)


def matrix_of(mesh: TetMesh):
    return ebb.interop.bsr_matrix(mesh.edges.a, row=mesh.edges.tail, col=mesh.edges.head)


def test_blocks_are_a_bsr_matrix_on_the_same_memory():
    mesh = TetMesh.ball(2, self_edges=True)
    laplacian(mesh)
    matrix = matrix_of(mesh)
    assert matrix.format == "bsr" and matrix.blocksize == (3, 3)
    assert matrix.data.ctypes.data == mesh.edges.a.view().ctypes.data
    assert matrix.indices.ctypes.data == mesh.edges.head.view().ctypes.data
    assert matrix.indptr.ctypes.data == mesh.edges.tail.grouping.offsets.ctypes.data
    np.testing.assert_array_equal(matrix.toarray(), dense(mesh))
    b = np.random.default_rng(0).normal(size=(mesh.vertices.size, 3))
    np.testing.assert_allclose(spsolve(matrix.tocsc(), b.ravel()), np.linalg.solve(dense(mesh), b.ravel()), rtol=1e-10)


def test_numbers_are_a_csr_matrix_on_the_same_memory():
    mesh = TetMesh.ball(2, self_edges=True)
    laplacian(mesh, ebb.float64)
    matrix = matrix_of(mesh)
    assert matrix.format == "csr"
    assert matrix.data.ctypes.data == mesh.edges.a.view().ctypes.data
    assert matrix.indices.ctypes.data == mesh.edges.head.view().ctypes.data
    b = np.arange(mesh.vertices.size) + 0.5
    np.testing.assert_allclose(matrix @ b, dense(mesh) @ b, rtol=1e-12)
    np.testing.assert_allclose(spsolve(matrix, b), np.linalg.solve(dense(mesh), b), rtol=1e-10)


def test_the_matrix_shows_what_kernels_write():
    mesh = TetMesh.ball(1, self_edges=True)
    laplacian(mesh)
    matrix = matrix_of(mesh)
    edges = mesh.edges

    @ebb.kernel
    def double(e: edges):
        e.a *= 2

    before = dense(mesh)
    for _ in range(20):  # so that there is every occasion to choose another order or layout
        double(edges)
    np.testing.assert_array_equal(matrix.toarray(), 2.0**20 * before)


def test_rows_that_lie_in_another_order_are_brought_back():
    mesh = TetMesh.ball(2, self_edges=True)
    laplacian(mesh)
    mesh.vertices.permute(np.random.default_rng(1).permutation(mesh.vertices.size))
    assert not np.array_equal(mesh.vertices.storage.order, np.arange(mesh.vertices.size))
    matrix = matrix_of(mesh)
    np.testing.assert_array_equal(matrix.toarray(), dense(mesh))
    np.testing.assert_array_equal(mesh.vertices.pos.view(), mesh.vertices.pos.to_numpy())


def test_columns_may_stand_in_any_order_and_a_key_need_not_be_grouped():
    rows, columns = ebb.Relation("rows", size=3), ebb.Relation("columns", size=4)
    entries = ebb.Relation("entries", size=6)
    row, column = np.array([2, 0, 2, 0, 1, 2]), np.array([3, 1, 0, 0, 2, 3])
    entries.new_field("row", rows, init=row)
    entries.new_field("column", columns, init=column)
    entries.new_field("a", ebb.matrix(ebb.float32, 2, 3), init=np.arange(36).reshape(6, 2, 3))
    matrix = ebb.interop.bsr_matrix(entries.a, row=entries.row, col=entries.column)
    assert matrix.shape == (6, 12) and matrix.dtype == np.float32
    assert matrix.data.ctypes.data == entries.a.view().ctypes.data
    expected = np.zeros((3, 4, 2, 3))
    np.add.at(expected, (row, column), np.arange(36).reshape(6, 2, 3))  # what stands at one place adds up
    np.testing.assert_array_equal(matrix.toarray(), expected.transpose(0, 2, 1, 3).reshape(6, 12))


def test_components_that_lie_in_columns_are_brought_together():
    mesh = TetMesh.box(20, 20, 20, self_edges=True)
    laplacian(mesh)
    edges = mesh.edges

    @ebb.kernel
    def straight(e: edges):
        e.a = e.a @ e.a.T + e.a

    for _ in range(12):
        edges.a.fill(0.0)
        straight(edges)
    before = edges.a.to_numpy()
    matrix = matrix_of(mesh)
    assert matrix.data.flags.c_contiguous
    assert matrix.data.ctypes.data == edges.a.view().ctypes.data
    np.testing.assert_array_equal(edges.a.to_numpy(), before)


def test_it_is_read_only():
    mesh = TetMesh.ball(1, self_edges=True)
    laplacian(mesh)
    matrix = matrix_of(mesh)
    for array in (matrix.data, matrix.indices, matrix.indptr):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0
    edges = mesh.edges
    edges.tail.load(edges.tail.to_numpy()[::-1].copy())  # groups anew, into other memory
    np.testing.assert_array_equal(np.diff(matrix.indptr).sum(), edges.size)


def test_what_is_no_matrix():
    mesh = TetMesh.ball(1, self_edges=True)
    edges, tetrahedra = mesh.edges, mesh.tetrahedra
    edges.new_field("a", ebb.float64)
    edges.new_field("later", mesh.vertices)

    def message(values, row, col):
        with pytest.raises(ebb.RelationError, match="E552") as caught:
            ebb.interop.bsr_matrix(values, row=row, col=col)
        return str(caught.value)

    assert "should be of one key" in message(edges.a, edges.a, edges.head)
    assert "another relation" in message(edges.a, edges.tail, tetrahedra.v)
    assert "numbers or matrices" in message(edges.tail, edges.tail, edges.head)
    assert "not stored in the order of head" in message(edges.a, edges.head, edges.tail)
    assert "unset" in message(edges.a, edges.tail, edges.later)
    other = TetMesh.ball(1, self_edges=True)
    other.edges.new_field("a", ebb.float64)
    other.vertices.permute(np.arange(other.vertices.size)[::-1])
    other.vertices.pos.view()
    assert "a view of them has been taken" in message(other.edges.a, other.edges.tail, other.edges.head)
    with ebb.capture(), pytest.raises(ebb.BackendError, match="E607"):
        matrix_of(mesh)
