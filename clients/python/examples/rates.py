"""Measures rate and duration of exchanges between a Python program and a board: python rates.py [PORT]."""

import sys
import time

import numpy as np

import haptic_bridge as hb


def main(port="sim", count=3000):
    with hb.Board(port) as board:
        board.look()
        times = np.empty(count)
        for i in range(count):
            began = time.perf_counter()
            state = board.look()
            times[i] = time.perf_counter() - began
    print(f"{port}: {count / times.sum():.0f} exchanges a second, median {1e6 * np.median(times):.0f} us, 99 % within "
          f"{1e6 * np.quantile(times, 0.99):.0f} us; the tip is at {state.tip.round(4)} m")


if __name__ == "__main__":
    main(*sys.argv[1:])
