# SPDX-License-Identifier: Apache-2.0
"""Make command lines and YAML files readable that the middleware would refuse as a whole for one value.

The middleware's parser stops the process at a list such as [0, 0, -9.81], whose numbers are not all of one type. It
also stops at an empty value or mapping and at nested lists. Here whole numbers in such lists become decimals; what no
parameter can hold is left out with one sentence. Files without such trouble are passed on untouched. A pipe, which can
be read only once, is passed on as a copy.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path

import yaml

_NUMBER = ("tag:yaml.org,2002:int", "tag:yaml.org,2002:float")
_DECIMAL = re.compile(r"[-+]?((0|[1-9]\d*)(\.\d*)?|\.\d+)([eE][-+]?\d+)?")
Complain = Callable[[str], None]
_Seen = dict[str, tuple[yaml.MappingNode, tuple[yaml.Node, yaml.Node]]]


def readable_arguments(
    arguments: list[str], folder: Path, complain: Complain
) -> tuple[list[str], dict[str, list[str]]]:
    """Return `arguments` with the files after --params-file and the values after -p made readable.

    Also return path -> keys of the nodes that each file has parameters for. Copies of files lie in `folder`, until the
    middleware has read them. Raises ValueError in one sentence for a file that is missing or no YAML.
    """
    result, keys = list(arguments), {}
    for k in range(1, len(result)):
        if result[k - 1] == "--params-file":
            path = result[k]
            result[k], keys[path] = _readable_file(path, folder / f"{k}.yaml", complain)
        elif result[k - 1] in ("-p", "--param") and ":=" in result[k]:
            result[k] = _readable_override(result[k])
    return result, keys


def is_for(key: str, node: str) -> bool:
    """Return True if the parameters under `key` of a file are for the node of this fully qualified name."""
    pattern = re.escape(key).replace(r"/\*\*", r"(/\w+)*").replace(r"/\*", r"/\w+")
    return re.fullmatch(pattern, node) is not None


def _readable_file(path: str, copy: Path, complain: Complain) -> tuple[str, list[str]]:
    try:
        text = Path(path).read_text()
        root = yaml.compose(text)
        keys = list(_node_keys(root, "")) if isinstance(root, yaml.MappingNode) else []
        if not all(keys) or not keys:
            begin = "it must begin with a node's name, such as /**:, and ros__parameters: below it"
            raise ValueError(f"the parameter file {path} holds no parameters; {begin}")
        for alias in (event for event in yaml.parse(text) if isinstance(event, yaml.AliasEvent)):
            where = f"the parameter file {path}, line {alias.start_mark.line + 1}"
            raise ValueError(f"{where}: *{alias.anchor} is not known here; write out what it stands for")
        repeated = _drop_repeated(root, path, "", complain, {})
        mended = _mend(root, path, "", complain) or repeated
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"the parameter file {path} cannot be read: {error}") from None
    except yaml.YAMLError as error:
        raise ValueError(f"the parameter file {path}{_told(error)}") from None
    except RecursionError:
        raise ValueError(f"the parameter file {path} is nested too deeply to be read") from None
    if not mended and Path(path).is_file():
        return path, keys
    copy.write_text(yaml.serialize(root))
    return str(copy), keys


def _node_keys(mapping: yaml.MappingNode, prefix: str) -> Iterator[str]:
    for key, value in mapping.value:
        if key.value == "ros__parameters":
            yield prefix
        elif isinstance(value, yaml.MappingNode) and isinstance(key, yaml.ScalarNode):
            yield from _node_keys(value, f"{prefix}/{key.value.strip('/')}")


def _told(error: yaml.YAMLError) -> str:
    """Return what is wrong in a file that is no YAML, and in which line, in words that follow its path."""
    if isinstance(error, yaml.MarkedYAMLError) and error.problem and error.problem_mark:
        return f", line {error.problem_mark.line + 1}, is not valid YAML: {error.problem}"
    return f" is not valid YAML: {' '.join(str(error).split())}"


def _drop_repeated(mapping: yaml.MappingNode, path: str, prefix: str, complain: Complain, seen: _Seen) -> bool:
    """Keep the last value of a name that has several, as the middleware would take one by its type; True if any had.

    seen: name -> the mapping that holds its value so far, and where in it.
    """
    mended = False
    for pair in list(mapping.value):
        key, value = pair
        if not isinstance(key, yaml.ScalarNode):
            continue
        name, line = f"{prefix}{key.value}", key.start_mark.line + 1
        if key.value == "ros__parameters":
            mended |= isinstance(value, yaml.MappingNode) and _drop_repeated(value, path, "", complain, {})
        elif isinstance(value, yaml.MappingNode):
            mended |= _drop_repeated(value, path, f"{name}.", complain, seen)
        else:
            if name in seen:
                owner, old = seen[name]
                owner.value = [each for each in owner.value if each is not old]
                where = f"{path}, line {line}"
                shown = " ".join(name.split())
                complain(f"{where}: {shown} stands in line {old[0].start_mark.line + 1} too; this one counts")
                mended = True
            seen[name] = mapping, pair
    return mended


def _mend(mapping: yaml.MappingNode, path: str, prefix: str, complain: Complain, inside: bool = False) -> bool:
    """Mend `mapping` in place; return True if anything changed. inside: True below ros__parameters."""
    mended, kept = False, []
    for key, value in mapping.value:
        if not isinstance(key, yaml.ScalarNode):
            complain(f"{path}, line {key.start_mark.line + 1}: a list or a mapping is no name and is ignored")
            mended = True
            continue
        name, trouble = f"{prefix}{key.value}", ""
        if isinstance(value, yaml.MappingNode):
            inner = "" if key.value == "ros__parameters" or not prefix and key.value[:1] in "/" else f"{name}."
            mended |= _mend(value, path, inner, complain, inside or key.value == "ros__parameters")
            if not value.value:  # the middleware's parser takes the next line for part of an empty mapping
                mended = True
                continue
        elif key.value == "ros__parameters" and (value.value or isinstance(value, yaml.SequenceNode)):
            trouble = "has no names with values below it"
        elif not inside and value.value:
            trouble = "stands outside of ros__parameters"
        elif isinstance(value, yaml.SequenceNode):
            trouble = _trouble(value)
            if not trouble and not _one_type(value):
                _to_decimals(value)
                mended = True
        elif value.tag.endswith(":null") and not value.value:
            trouble = "has no value"
        if trouble:
            shown = " ".join(name.split())
            complain(f"{path}, line {key.start_mark.line + 1}: {shown} {trouble} and is ignored")
            mended = True
        else:
            kept.append((key, value))
    mapping.value = kept
    return mended


def _trouble(sequence: yaml.SequenceNode) -> str:
    """Return why no parameter can hold this list, in words that follow its name; "" if one can."""
    items = sequence.value
    if not all(isinstance(item, yaml.ScalarNode) for item in items):
        return "is no list of one type"
    odd = [item.value for item in items if item.tag in _NUMBER and not _DECIMAL.fullmatch(item.value)]
    if odd:
        return f"holds {odd[0]}, but numbers in a list must be finite decimals,"
    if not _one_type(sequence) and not all(_DECIMAL.fullmatch(item.value) for item in items):
        return "is no list of one type"
    return ""


def _one_type(sequence: yaml.SequenceNode) -> bool:
    return len({item.tag for item in sequence.value}) <= 1


def _to_decimals(sequence: yaml.SequenceNode) -> None:
    sequence.value = [yaml.ScalarNode(_NUMBER[1], _decimal(float(item.value))) for item in sequence.value]


def _decimal(value: float) -> str:
    """Return text that YAML takes for a decimal by itself, which it does to 1.0e-05 and not to 1e-05."""
    text = repr(value)
    return text if "." in text else text.replace("e", ".0e")


def _readable_override(argument: str) -> str:
    name, _, text = argument.partition(":=")
    try:
        value = yaml.compose(text)
    except yaml.YAMLError:
        return argument
    if not isinstance(value, yaml.SequenceNode):
        return argument
    trouble = _trouble(value)
    if trouble:
        raise ValueError(f"{name} on the command line {trouble.rstrip(',')}")
    if _one_type(value):
        return argument
    _to_decimals(value)
    return f"{name}:=[{', '.join(item.value for item in value.value)}]"
