"""What of a body, besides its particles, the watch keeps or puts back at the end of a frame (watch.py)."""

import warp as wp

from cloth_sim_ros.sim.model import Body, Features
from cloth_sim_ros.sim.state import State


def make_slacken(features: Features):
    """A Warp function: segment k of the batch, of a body that is put back, forgets what it carried."""

    @wp.func
    def slacken(k: int, s: State):
        s.tensions[k] = 0.0
        if wp.static(features.beam):
            s.moments[k] = wp.vec3(0.0)
        if wp.static(features.twist):
            s.couples[k] = wp.vec3(0.0)

    return slacken


def make_settle_ends(features: Features):
    """A Warp function: the twist and the winch of body b go back to where they were last good, or are good."""

    @wp.func
    def settle_ends(b: int, faulty: bool, s: State):
        if wp.static(features.twist):
            if faulty:
                s.twists[b] = s.good_twists[b]
            else:
                s.good_twists[b] = s.twists[b]
        if wp.static(features.winch):
            if faulty:
                s.reels[b] = s.good_reels[b]
            else:
                s.good_reels[b] = s.reels[b]

    return settle_ends


def make_settle_body(features: Features):
    """A Warp function: what of body b besides its particles the watch keeps or puts back at the end of a frame."""
    slacken, settle_ends = make_slacken(features), make_settle_ends(features)

    @wp.func
    def settle_body(t: int, width: int, b: int, faulty: bool, relapses: int, history: int, s: State, body: Body):
        if faulty:
            for k in range(body.segments + t, body.segments_end, width):
                slacken(k, s)
        if t == 0:
            settle_ends(b, faulty, s)
            s.relapses[b] = wp.where(faulty, relapses + 1, 0)
            if faulty:
                s.recoveries[b] += 1
            if wp.static(features.looks_back):
                s.history[b] = wp.where(faulty, 0, history)

    return settle_body
