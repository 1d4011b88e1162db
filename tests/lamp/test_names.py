"""Unique names."""

from lumitree.lamp.names import Names


def test_names_are_unique_whatever_their_case():
    names = Names("-")
    wanted = ["a", "A", "a-2", "a", "b"]
    assert [names.unique(name) for name in wanted] == ["a", "A-2", "a-2-2", "a-3", "b"]


def test_many_of_one_name_take_linear_time():
    class Counted(set):
        looked_up = 0

        def __contains__(self, name):
            Counted.looked_up += 1
            return super().__contains__(name)

    names = Names("_")
    names._taken = Counted()
    assert len({names.unique("lamp") for _ in range(3000)}) == 3000
    assert Counted.looked_up <= 3 * 3000
