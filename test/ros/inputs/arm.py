# SPDX-License-Identifier: Apache-2.0
"""An arm of plain shapes and one link from a file, as robot_state_publisher would describe it."""

from xml.sax.saxutils import quoteattr

LENGTH = 0.15  # [m] of a link


def link(name, geometry="", origin='xyz="0 0 0.075" rpy="0 0 0"'):
    """A link, which collides if it has a geometry."""
    collision = f"<collision><origin {origin}/><geometry>{geometry}</geometry></collision>" if geometry else ""
    return f"<link name={quoteattr(name)}>{collision}</link>"


def joint(name, kind, parent, child, origin, more='<axis xyz="0 1 0"/>'):
    """A joint between two links."""
    limit = '<limit lower="-3" upper="3" effort="1" velocity="1"/>'
    return (
        f"<joint name={quoteattr(name)} type={quoteattr(kind)}><parent link={quoteattr(parent)}/>"
        f"<child link={quoteattr(child)}/><origin {origin}/>{more}{limit}</joint>"
    )


def chain(links, geometry='<cylinder radius="0.03" length="0.12"/>'):
    """An arm of this many links, one upon another; each joint turns about y."""
    parts = [link("base")]
    for k in range(links):
        parts.append(link(f"link_{k}", geometry))
        above = f"link_{k - 1}" if k else "base"
        parts.append(joint(f"joint_{k}", "revolute", above, f"link_{k}", f'xyz="0 0 {LENGTH if k else 0}"'))
    return f'<robot name="chain">{"".join(parts)}</robot>'


def arm(mesh):
    """Base, shoulder, elbow and wrist of a box, cylinder, sphere and a mesh file, and two fingers, of which one mimics
    the other."""
    turned = 'xyz="0.02 0 0.1" rpy="0.3 -0.4 0.5"'
    return "".join(
        (
            '<robot name="arm">',
            link("base", '<box size="0.2 0.2 0.1"/>'),
            link("shoulder", '<cylinder radius="0.04" length="0.2"/>', turned),
            link("elbow", '<sphere radius="0.05"/>'),
            link("wrist", f'<mesh filename="{mesh}" scale="0.001 0.001 0.001"/>', turned),
            link("left_finger", '<box size="0.02 0.01 0.05"/>'),
            link("right_finger", '<box size="0.02 0.01 0.05"/>'),
            joint("pan", "continuous", "base", "shoulder", 'xyz="0 0 0.1"', '<axis xyz="0 0 2"/>'),
            joint("lift", "revolute", "shoulder", "elbow", 'xyz="0 0.05 0.3" rpy="0.2 0 0.1"'),
            joint("bend", "revolute", "elbow", "wrist", 'xyz="0 0 0.3"', '<axis xyz="1 1 0"/>'),
            joint("grip", "prismatic", "wrist", "left_finger", 'xyz="0 0 0.1"'),
            joint(
                "other",
                "prismatic",
                "wrist",
                "right_finger",
                'xyz="0 0 0.1"',
                '<axis xyz="0 1 0"/><mimic joint="grip" multiplier="-1" offset="0.01"/>',
            ),
            "</robot>",
        )
    )
