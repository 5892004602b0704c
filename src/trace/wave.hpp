// One wave of a backward ray tracer (Whitted 1980): all rays that light has turned equally often, together.
//
//   wave_rays.hpp   the rays and what they meet
//   nearest.hpp     March to each layer's surface, Keep what the nearest looks like, MeetGround
//   occlude.hpp     Occlude: shadow and ambient rays
//   lit.hpp         Lit: add up the light, count mirrored and transmitted rays
//   spawn.hpp       Spawn: send those on as the next wave
//   finish.hpp      Finish: after the last, a pass more in the picture
#pragma once
#include "trace/finish.hpp"
#include "trace/lit.hpp"
#include "trace/nearest.hpp"
#include "trace/occlude.hpp"
#include "trace/spawn.hpp"
