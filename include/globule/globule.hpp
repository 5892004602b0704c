// globule: particles in, smooth exact surfaces and volumes out.  This header includes all others; docs/reference/cpp.md
// begins with examples.
#pragma once
#include "globule/array.hpp"
#include "globule/camera.hpp"
#include "globule/device.hpp"
#include "globule/error.hpp"
#include "globule/frame.hpp"
#include "globule/mesh.hpp"
#include "globule/particles.hpp"
#include "globule/poll.hpp"
#include "globule/render_settings.hpp"
#include "globule/scene.hpp"
#include "globule/simulation.hpp"
#include "globule/tissue.hpp"
#include "globule/values.hpp"
#include "globule/vector.hpp"
#include "globule/version.hpp"
#include "globule/volume.hpp"
