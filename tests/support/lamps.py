"""Small luminaires as scene files, for tests."""

AREA = '<emitter type="area"><rgb name="radiance" value="3,2,1"/></emitter>'
GLASS = (
    '<bsdf type="dielectric"><float name="int_ior" value="1.5"/>'
    '<float name="ext_ior" value="1"/></bsdf>'
)


def scene(*shapes):
    """Text of a scene file."""
    return f'<scene version="3.0.0">{"".join(shapes)}</scene>'


def lamp_of(folder, *shapes):
    """The luminaire of a scene file, which is written."""
    from lumitree.lamp.luminaire import load_luminaire

    path = folder / "lamp.xml"
    path.write_text(scene(*shapes))
    return load_luminaire(path)


def sphere(name, radius, centre=(0, 0, 0), inside="", flip=False):
    """A sphere; `inside` is what the element holds besides, such as a BSDF."""
    x, y, z = centre
    flipped = '<boolean name="flip_normals" value="true"/>' if flip else ""
    return (
        f'<shape type="sphere" id="{name}"><float name="radius" value="{radius}"/>'
        f'<point name="center" x="{x}" y="{y}" z="{z}"/>{flipped}{inside}</shape>'
    )


def cube(name, half, centre=(0, 0, 0), inside=""):
    """A cube of the given half side, or three half sides."""
    x, y, z = half if isinstance(half, tuple) else (half,) * 3
    a, b, c = centre
    return (
        f'<shape type="cube" id="{name}"><transform name="to_world">'
        f'<scale x="{x}" y="{y}" z="{z}"/><translate x="{a}" y="{b}" z="{c}"/></transform>'
        f"{inside}</shape>"
    )


def room(width, height, more=""):
    """Text of a scene: a floor below (0, 1, 0), seen by a camera of few pixels."""
    return scene(
        '<integrator type="path"><integer name="max_depth" value="4"/></integrator>'
        '<sensor type="perspective"><transform name="to_world">'
        '<lookat origin="0,1,6" target="0,0.5,0" up="0,1,0"/></transform><film type="hdrfilm">'
        f'<integer name="width" value="{width}"/><integer name="height" value="{height}"/></film>'
        '</sensor><shape type="rectangle"><transform name="to_world">'
        '<rotate x="1" angle="-90"/><scale value="4"/></transform></shape>',
        more,
    )


# A lamp that is a ball of radius 1.
BALL = scene(sphere("ball", 1, inside=AREA))
