# SPDX-License-Identifier: Apache-2.0
"""Services of parameters. Every request gets an answer; one that sets a parameter gets it once that is decided.

The services of rclpy leave a client without an answer if a value has an unknown type. The node would also stand still
while the values are checked.
"""

from __future__ import annotations

import math
import time
import types
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from typing import Any

from rcl_interfaces.msg import ListParametersResult, ParameterDescriptor, ParameterValue, SetParametersResult
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    GetParameterTypes,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_parameters

from cloth_sim_ros.parameters import shown
from cloth_sim_ros.ros.parameters.bridge import ParameterBridge


class ParameterServices:
    """The six services of `node`, which was made without rclpy's.

    bridge.decide(parameters) raises ValueError for values that are not allowed. It runs in a thread of its own, for one
    request after the other, and the executor goes on meanwhile.
    """

    def __init__(self, node: Node, bridge: ParameterBridge):
        self._node, self._bridge = node, bridge
        self._deciding = ThreadPoolExecutor(max_workers=1, thread_name_prefix="deciding")
        self._last: Future | None = None
        one_by_one, at_once = MutuallyExclusiveCallbackGroup(), ReentrantCallbackGroup()
        for kind, name, callback, group in (
            (GetParameters, "get_parameters", self._get, at_once),
            (GetParameterTypes, "get_parameter_types", self._types, at_once),
            (DescribeParameters, "describe_parameters", self._describe, at_once),
            (ListParameters, "list_parameters", self._list, at_once),
            (SetParameters, "set_parameters", self._set, one_by_one),
            (SetParametersAtomically, "set_parameters_atomically", self._set_atomically, one_by_one),
        ):
            node.create_service(kind, f"~/{name}", callback, qos_profile=qos_profile_parameters, callback_group=group)

    def stop(self) -> bool:
        """End the decisions; return False if the thread is still at one."""
        self._deciding.shutdown(wait=False, cancel_futures=True)
        return self._last is None or self._last.done()

    def _get(self, request: Any, response: Any) -> Any:
        response.values = [
            self._node.get_parameter(name).get_parameter_value() if self._node.has_parameter(name) else ParameterValue()
            for name in request.names
        ]
        return response

    def _types(self, request: Any, response: Any) -> Any:
        response.types = [value.type for value in self._get(request, GetParameters.Response()).values]
        return response

    def _describe(self, request: Any, response: Any) -> Any:
        response.descriptors = [
            self._node.describe_parameter(name) if self._node.has_parameter(name) else ParameterDescriptor(name=name)
            for name in request.names
        ]
        return response

    def _list(self, request: Any, response: Any) -> Any:
        try:
            response.result = self._node.list_parameters(list(request.prefixes), request.depth)
        except (TypeError, ValueError):
            response.result = ListParametersResult()
        return response

    async def _set(self, request: Any, response: Any) -> Any:
        for message in request.parameters:
            response.results.append(await self._result([message]))
        return response

    async def _set_atomically(self, request: Any, response: Any) -> Any:
        response.result = await self._result(request.parameters)
        return response

    async def _result(self, messages: list[Any]) -> SetParametersResult:
        try:
            parameters = [_parameter(message) for message in messages]
            self._last = self._deciding.submit(partial(self._bridge.decide, parameters))
            await settled(self._node, self._last)
            result = self._node.set_parameters_atomically(parameters)
            if result.successful:
                result.reason = self._bridge.remark(parameters)
            return result
        except Exception as error:
            return SetParametersResult(successful=False, reason=str(error))


def _parameter(message: Any) -> Parameter:
    try:
        return Parameter.from_parameter_msg(message)
    except ValueError:
        raise ValueError(
            f"{shown(message.name)} is sent as type {message.value.type}; allowed are those of ParameterType, 0 to 9"
        ) from None


async def settled(node: Node, future: Future, patience: float = math.inf) -> Any:
    """Return the result of a future of another thread, while the executor of `node` goes on.

    Raises the future's exception, and TimeoutError after `patience` [s].
    """
    end = time.monotonic() + patience
    future.add_done_callback(lambda _: node.executor.wake())
    await _until(lambda: future.done() or time.monotonic() > end)
    return future.result(timeout=0.0)


@types.coroutine
def _until(condition: Callable[[], bool]) -> Any:
    while not condition():  # the executor asks again whenever it is woken
        yield
