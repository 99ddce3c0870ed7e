# SPDX-License-Identifier: Apache-2.0
"""Particles exchanged between pieces of bodies that are all on a GPU at once, within one launch.

A particle is three messages of 16 bytes, each with its own number. A message is written and read whole, as a 128-bit
access is atomic in PTX's memory model. A reader that finds the number that it waits for has the rest as well. This
needs no flag and no fence, and goes through the cache once. Two sides alternate. A piece sends a round only after it
has received the round before from all its neighbours. They sent that after they had read the round before it.
"""

import warp as wp

from cloth_sim_ros.sim.intrinsics import array_address, as_index
from cloth_sim_ros.sim.native import source

_WHOLE_MESSAGES = 70  # compute capability of GPUs that read and write 16 bytes at once, times 10
# Reads of a message that does not come, about a second. Blocks of one launch that all fit run at once unless another
# stream fills the GPU for as long; the body is then put back, as after any other fault.
_PATIENCE = wp.constant(1 << 21)
_NUMBERED = wp.constant(-(1 << 31))  # the bit that tells a number from what was never sent


def run_at_once(pieces: int, device: wp.Device) -> bool:
    """Whether all `pieces`, of a block each, are on the device at once, as those must be that wait for one another."""
    return device.is_cuda and device.arch >= _WHOLE_MESSAGES and pieces <= device.sm_count


@wp.func_native(source(__file__, "halo_send"))
def send_message(address: wp.uint64, i: int, v: wp.vec3, number: int): ...


@wp.func_native(source(__file__, "halo_peek"))
def peek(address: wp.uint64, i: int) -> wp.vec4: ...


@wp.struct
class Exchange:
    """Where the messages of one particle lie: the first of them on side 0 and how far apart they are. Also the side in
    turn, the number of the frame's first message, and how many reads are left to one that is waited for."""

    messages: wp.uint64
    first: int
    apart: int
    side: int
    number: int
    patience: int


@wp.struct
class Message:
    """A particle that was received, in its first three numbers each; `late` if it was not."""

    x: wp.vec4
    low: wp.vec4
    v: wp.vec4
    late: bool


@wp.func
def exchange_of(particle: int, count: int, messages: wp.array(dtype=wp.vec4), number: int) -> Exchange:
    """The exchange of one of the `count` particles of all worlds; `number`: of the frame's first message."""
    found = Exchange()
    found.messages = array_address(messages, 0)
    found.first = particle
    found.apart = count
    found.number = number
    found.patience = _PATIENCE
    return found


@wp.func
def send(x: wp.vec3, low: wp.vec3, v: wp.vec3, exchange: Exchange, k: int):
    """Send a particle before substep k of the frame."""
    i = exchange.first + 3 * exchange.side * exchange.apart
    number = (exchange.number + k) | _NUMBERED
    send_message(exchange.messages, i, x, number)
    send_message(exchange.messages, i + exchange.apart, low, number)
    send_message(exchange.messages, i + 2 * exchange.apart, v, number)


@wp.func
def receive(exchange: Exchange, k: int) -> Message:
    """Wait for a particle as it is before substep k of the frame."""
    i = exchange.first + 3 * exchange.side * exchange.apart
    number = (exchange.number + k) | _NUMBERED
    message = Message()
    message.late = True
    tries = int(0)
    while message.late and tries < exchange.patience:
        message.x = peek(exchange.messages, i)
        message.low = peek(exchange.messages, i + exchange.apart)
        message.v = peek(exchange.messages, i + 2 * exchange.apart)
        same = as_index(message.x[3]) == number and as_index(message.low[3]) == number
        message.late = not (same and as_index(message.v[3]) == number)
        tries += 1
    return message
