# find_package(globule) gives the target globule::globule.
include("${CMAKE_CURRENT_LIST_DIR}/globuleTargets.cmake")
