"""ParaView 5.11 of Debian 12 takes a name from Python that Python 3.11 no longer has, and loads no plugin
in Python without it. With this folder on PYTHONPATH, the name is there."""

import inspect

if not hasattr(inspect, "getargspec"):
    inspect.getargspec = inspect.getfullargspec
