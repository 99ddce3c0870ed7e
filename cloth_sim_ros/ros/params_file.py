"""Command lines and YAML files that the middleware would refuse as a whole for one value, made readable.

The middleware's parser stops the process at a list such as [0, 0, -9.81], whose numbers are not all of one type. It
also stops at an empty value and at nested lists. Here whole numbers in such lists become decimals; what no parameter
can hold is left out with one sentence. Files without such trouble are passed on untouched.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

import yaml

_NUMBER = ("tag:yaml.org,2002:int", "tag:yaml.org,2002:float")
Complain = Callable[[str], None]


def readable_arguments(arguments: list[str], complain: Complain) -> list[str]:
    """`arguments` with the files after --params-file and the values after -p made readable.

    Raises ValueError in one sentence for a file that is missing or no YAML.
    """
    result = list(arguments)
    for k in range(1, len(result)):
        if result[k - 1] == "--params-file":
            result[k] = _readable_file(result[k], complain)
        elif result[k - 1] in ("-p", "--param") and ":=" in result[k]:
            result[k] = _readable_override(result[k])
    return result


def _readable_file(path: str, complain: Complain) -> str:
    try:
        root = yaml.compose(Path(path).read_text())
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"the parameter file {path} cannot be read: {error}") from None
    except yaml.YAMLError as error:
        raise ValueError(f"the parameter file {path} is not valid YAML: {' '.join(str(error).split())}") from None
    if not isinstance(root, yaml.MappingNode):
        raise ValueError(f"the parameter file {path} holds no parameters; it must start with a node's name")
    if not _mend(root, path, "", complain):
        return path
    with tempfile.NamedTemporaryFile("w", prefix="cloth_sim_", suffix=".yaml", delete=False) as file:
        file.write(yaml.serialize(root))
    return file.name


def _mend(mapping: yaml.MappingNode, path: str, prefix: str, complain: Complain) -> bool:
    """Mends `mapping` in place; whether anything had to be."""
    mended, kept = False, []
    for key, value in mapping.value:
        name = f"{prefix}{key.value}"
        if isinstance(value, yaml.MappingNode):
            inner = "" if key.value == "ros__parameters" or not prefix and key.value[:1] in "/" else f"{name}."
            mended |= _mend(value, path, inner, complain)
        elif isinstance(value, yaml.SequenceNode):
            trouble = not _one_type(value)
            mended |= trouble
            if trouble and not _to_decimals(value):
                complain(f"{path}, line {value.start_mark.line + 1}: {name} is no list of one type and is ignored")
                continue
        elif value.tag.endswith(":null") and not value.value:
            complain(f"{path}, line {key.start_mark.line + 1}: {name} has no value and is ignored")
            mended = True
            continue
        kept.append((key, value))
    mapping.value = kept
    return mended


def _one_type(sequence: yaml.SequenceNode) -> bool:
    return (
        all(isinstance(item, yaml.ScalarNode) for item in sequence.value)
        and len({item.tag for item in sequence.value}) <= 1
    )


def _to_decimals(sequence: yaml.SequenceNode) -> bool:
    """Turns whole numbers of a list of numbers into decimals; False if it holds anything else."""
    for item in sequence.value:
        if not isinstance(item, yaml.ScalarNode) or not (item.tag in _NUMBER or _is_number(item.value)):
            return False
    sequence.value = [yaml.ScalarNode(_NUMBER[1], repr(float(item.value))) for item in sequence.value]
    return True


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _readable_override(argument: str) -> str:
    name, _, text = argument.partition(":=")
    try:
        value = yaml.compose(text)
    except yaml.YAMLError:
        return argument
    if isinstance(value, yaml.SequenceNode) and not _one_type(value) and _to_decimals(value):
        return f"{name}:=[{', '.join(item.value for item in value.value)}]"
    return argument
