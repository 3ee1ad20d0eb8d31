"""Values fall into the bucket whose upper end is the first that is not below them."""

from chunkserver.server.histogram import Histogram


def test_each_value_is_in_one_bucket_and_upper_ends_belong_to_theirs():
    histogram = Histogram((1.0, 2.0))
    for value in (0.0, 1.0, 1.5, 2.0, 2.5, 100.0):
        histogram.observe(value)
    assert histogram.counts == [2, 2, 2]
    assert histogram.total == 107.0
