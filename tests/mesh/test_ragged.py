import torch
from hypothesis import given
from hypothesis import strategies as st

from torchmesh.mesh import ragged as seg

COUNTS = st.lists(st.integers(0, 7), min_size=1, max_size=6)


def rows_of(counts, seed=0):
    return torch.randn(sum(counts), generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def pieces(values, counts):
    return list(values.split(counts))


@given(COUNTS)
def test_offsets_counts_and_ids_describe_the_same_rows(counts):
    offsets = seg.offsets_from_counts(torch.tensor(counts))
    assert offsets.dtype == torch.int64
    assert offsets.tolist() == [sum(counts[:b]) for b in range(len(counts) + 1)]
    assert seg.counts_from_offsets(offsets).tolist() == counts
    assert seg.segment_ids(offsets).tolist() == [b for b, n in enumerate(counts) for _ in range(n)]


@given(COUNTS)
def test_spread_repeats_each_value_over_its_rows(counts):
    offsets = seg.offsets_from_counts(torch.tensor(counts))
    values = torch.arange(2.0 * len(counts)).reshape(-1, 2)
    assert torch.equal(seg.spread(values, offsets), values[seg.segment_ids(offsets)])


@given(COUNTS)
def test_reductions_are_those_of_each_piece(counts):
    values, offsets = rows_of(counts), seg.offsets_from_counts(torch.tensor(counts))
    parts = pieces(values, counts)
    # A sum of at most seven numbers of size one: its order may change the last bits.
    torch.testing.assert_close(
        seg.segment_sum(values, offsets), torch.stack([p.sum() for p in parts]), rtol=0, atol=1e-14
    )
    assert seg.segment_max(values, offsets).tolist() == [max(p.tolist(), default=-torch.inf) for p in parts]
    assert seg.segment_min(values, offsets).tolist() == [min(p.tolist(), default=torch.inf) for p in parts]
    flags = values > 0
    assert seg.segment_count(flags, offsets).tolist() == [sum((p > 0).tolist()) for p in parts]
    assert seg.segment_any(flags, offsets).tolist() == [any((p > 0).tolist()) for p in parts]


def test_empty_is_a_floor_for_the_maximum_and_a_ceiling_for_the_minimum():
    offsets = torch.tensor([0, 0, 2])
    values = torch.tensor([-3.0, -2.0])
    assert seg.segment_max(values, offsets, empty=-1.0).tolist() == [-1.0, -1.0]
    assert seg.segment_min(-values, offsets, empty=1.0).tolist() == [1.0, 1.0]


def test_no_row_at_all():
    offsets = torch.zeros(4, dtype=torch.int64)
    none = torch.zeros(0, dtype=torch.float64)
    assert seg.segment_sum(none, offsets).tolist() == [0, 0, 0]
    assert seg.segment_count(none > 0, offsets).tolist() == [0, 0, 0]
    assert len(seg.segment_ids(offsets)) == 0


@given(st.integers(0, 40), st.integers(1, 200), st.integers(0, 40))
def test_a_sum_has_the_same_bits_whatever_stands_before_and_after(before, count, after):
    counts = [before, count, after]
    values, offsets = rows_of(counts, seed=count), seg.offsets_from_counts(torch.tensor(counts))
    alone = seg.segment_sum(values[before : before + count].clone(), torch.tensor([0, count]))
    assert torch.equal(seg.segment_sum(values, offsets)[1:2], alone)


@given(COUNTS)
def test_the_owner_of_a_row_is_its_mesh(counts):
    offsets = seg.offsets_from_counts(torch.tensor(counts))
    rows = torch.randperm(sum(counts), generator=torch.Generator().manual_seed(1))
    assert torch.equal(seg.owner_of(rows, offsets), seg.segment_ids(offsets)[rows])


@given(COUNTS, st.data())
def test_rows_of_each_mesh_come_as_often_as_it_is_named(counts, data):
    offsets = seg.offsets_from_counts(torch.tensor(counts))
    meshes = data.draw(st.lists(st.integers(0, len(counts) - 1), max_size=8))
    expected = [row for b in meshes for row in range(int(offsets[b]), int(offsets[b + 1]))]
    assert seg.rows_of_each(torch.tensor(meshes, dtype=torch.int64), offsets).tolist() == expected
