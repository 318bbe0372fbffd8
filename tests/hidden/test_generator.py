from tests.hidden import parts


def test_a():
    assert parts.SENSOR_MEMORY
