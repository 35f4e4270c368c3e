# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Axes and random numbers of sweeps: what is accepted, what is refused and in which words."""

from hypothesis import given, strategies
import numpy as np
from obc_ros.core.text.errors import StatementError
from obc_ros.sweep.axes import (
    check_count,
    make_axes,
    make_draws,
    MOST_POINTS,
    parse_axes,
    parse_draws,
    RandomNumber,
    SweepAxis,
)
import pytest
from scipy import stats


def test_a_range_has_both_ends_and_equal_steps():
    [axis] = make_axes(parse_axes(['x0.p=-2:2:101']))
    assert axis.key == 'x0.p' and len(axis.values) == 101
    assert (axis.values[0], axis.values[50], axis.values[-1]) == (-2.0, 0.0, 2.0)
    np.testing.assert_allclose(np.diff(axis.values), 0.04, rtol=1e-12)


@pytest.mark.parametrize('given', [
    '1, 2, 4', [1, 2, 4], (1.0, 2, 4), np.array([1, 2, 4]), np.array([1.0, 2, 4])])
def test_values_may_be_a_text_a_list_or_an_array(given):
    assert make_axes({'mass': given}) == (SweepAxis('mass', (1.0, 2.0, 4.0)),)


def test_numbers_may_be_expressions():
    [axis] = make_axes({'x0.theta': '-pi/2:pi/2:3'})
    assert axis.values == (-np.pi / 2, 0.0, np.pi / 2)


@pytest.mark.parametrize(('text', 'words'), [
    ('x0.p', 'wanted KEY=LOWER'), ('=1', 'wanted KEY=LOWER'), ('x0.p=', 'wanted KEY=LOWER'),
    ('x0.p=1:2', 'wanted LOWER:UPPER:NUMBER'), ('x0.p=1:2:3:4', 'wanted LOWER:UPPER:NUMBER'),
    ('x0.p=1:2:2.5', 'whole number'), ('x0.p=1:2:0', 'whole number'),
    ('x0.p=1:2:-3', 'whole number'), ('x0.p=1:1:3', '3 value(s) from 1 to 1'),
    ('x0.p=1:2:1', '1 value(s) from 1 to 2'), ('x0.p=nan:2:3', 'nan'), ('x0.p=1,nan', 'nan'),
    ('x0.p=1,inf', 'inf'), ('x0.p=1,,2', 'x0.p'), ('x0.p=1,2,1', 'the value 1 occurs twice'),
    ('x0.p=0:1:1e9', 'at most'), ('x0.p=__import__("os")', 'x0.p'), ('x0.p=1:b:3', "'b'")])
def test_a_bad_axis_is_refused_in_words(text, words):
    with pytest.raises(StatementError) as caught:
        make_axes(parse_axes([text]))
    assert words in str(caught.value)


@pytest.mark.parametrize('given', [
    None, {}, [[1, 2], [3, 4]], ['a'], [True], [1 + 2j], np.array(['1']), [], np.zeros(0),
    np.array([1.0, np.nan]), np.array([np.inf]), [None]])
def test_bad_values_are_refused(given):
    with pytest.raises(StatementError, match='mass'):
        make_axes({'mass': given})


@pytest.mark.parametrize(('text', 'words'), [
    ('x0.v', 'wanted KEY~normal'), ('~normal(0,1)', 'wanted KEY~normal'),
    ('x0.v~norml(0,1)', "did you mean 'normal'?"), ('x0.v~normal(0)', '2 parameters'),
    ('x0.v~normal(0,1,2)', '2 parameters'), ('x0.v~normal(0,0)', 'deviation > 0'),
    ('x0.v~normal(0,-1)', 'deviation > 0'), ('x0.v~lognormal(0,nan)', 'nan'),
    ('x0.v~uniform(2,1)', 'lower < upper'), ('x0.v~uniform(0,inf)', 'inf'),
    ('x0.v~normal', 'wanted one of'), ('x0.v~normal(0,1) x', 'wanted one of')])
def test_a_bad_distribution_is_refused_in_words(text, words):
    with pytest.raises(StatementError) as caught:
        make_draws(parse_draws([text]))
    assert words in str(caught.value)


def test_a_key_is_given_once():
    for parse, texts in ((parse_axes, ['a=1', 'a=2']), (parse_draws, ['a~normal(0,1)'] * 2)):
        with pytest.raises(StatementError, match='given twice'):
            parse(texts)
    with pytest.raises(StatementError, match='varied twice'):
        check_count(make_axes({'a': [1]}), make_draws({'a': 'normal(0,1)'}), 3)


def test_the_number_of_points_is_checked():
    axes, draws = make_axes({'a': '0:1:1001', 'b': '0:1:1000'}), make_draws({'c': 'normal(0,1)'})
    assert check_count(axes[:1], draws, 3) == 3003
    for bad in ((axes, (), 0), (axes[:1], draws, MOST_POINTS), ((), (), 0), ((), draws, 0),
                ((), draws, -1), (axes[:1], (), 5)):
        with pytest.raises(StatementError, match='points|vary|--count'):
            check_count(*bad)


@pytest.mark.parametrize(('draw', 'law'), [
    (RandomNumber('a', 'normal', (1.0, 2.0)), stats.norm(1.0, 2.0)),
    (RandomNumber('a', 'uniform', (-1.0, 3.0)), stats.uniform(-1.0, 4.0)),
    (RandomNumber('a', 'lognormal', (0.5, 0.3)), stats.lognorm(0.3, scale=np.exp(0.5)))])
def test_samples_have_their_distribution(draw, law):
    assert stats.kstest(draw.draw(4000, seed=1), law.cdf).pvalue > 0.01


@given(strategies.integers(0, 2**40), strategies.integers(1, 50))
def test_samples_depend_on_key_and_seed_only(seed, count):
    first = RandomNumber('a', 'normal', (0.0, 1.0))
    other = RandomNumber('b', 'normal', (0.0, 1.0))
    assert (first.draw(count, seed) == first.draw(count, seed)).all()
    assert (first.draw(count, seed) != first.draw(count, seed + 1)).all()
    assert (first.draw(count, seed) != other.draw(count, seed)).all()
