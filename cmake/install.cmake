# Where things are installed, and how other projects find them: find_package(globule) gives the target globule::globule.
# All paths are relative to the prefix, so that it can be moved.
include(CMakePackageConfigHelpers)
include(GNUInstallDirs)

if(GLOBULE_PYTHON)
  set(GLOBULE_LIBRARY_DIR globule)
  set(GLOBULE_BACKENDS_DIR globule)
  set(GLOBULE_INCLUDE_DIR globule/include)
  set(GLOBULE_CMAKE_DIR globule/cmake)
else()
  set(GLOBULE_LIBRARY_DIR ${CMAKE_INSTALL_LIBDIR})
  set(GLOBULE_BACKENDS_DIR ${CMAKE_INSTALL_LIBDIR}/globule)
  set(GLOBULE_INCLUDE_DIR ${CMAKE_INSTALL_INCLUDEDIR})
  set(GLOBULE_CMAKE_DIR ${CMAKE_INSTALL_LIBDIR}/cmake/globule)
endif()

function(globule_install target)
  if(NOT GLOBULE_PYTHON)  # a wheel holds no links
    set_target_properties(${target} PROPERTIES VERSION ${PROJECT_VERSION} SOVERSION ${PROJECT_VERSION_MAJOR}.${PROJECT_VERSION_MINOR})
  endif()
  install(TARGETS ${target} EXPORT globuleTargets LIBRARY DESTINATION ${GLOBULE_LIBRARY_DIR})
  install(DIRECTORY ${PROJECT_SOURCE_DIR}/include/globule DESTINATION ${GLOBULE_INCLUDE_DIR} FILES_MATCHING PATTERN "*.hpp")
  install(EXPORT globuleTargets NAMESPACE globule:: DESTINATION ${GLOBULE_CMAKE_DIR})
  write_basic_package_version_file(${PROJECT_BINARY_DIR}/globuleConfigVersion.cmake COMPATIBILITY SameMinorVersion)
  install(FILES ${PROJECT_SOURCE_DIR}/cmake/globuleConfig.cmake ${PROJECT_BINARY_DIR}/globuleConfigVersion.cmake DESTINATION ${GLOBULE_CMAKE_DIR})
endfunction()
