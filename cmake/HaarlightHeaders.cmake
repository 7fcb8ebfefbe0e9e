# System headers compiled once for all sources of a clang build: half of a small source's time. The
# release build does without, so that a source that forgets an include does not compile there.
#
# haarlight_precompile(NAME [FLAG ...])   compiles cmake/NAME_headers.h with these flags
# haarlight_use_headers(TARGET NAME)      TARGET's sources begin with it
#
# -include by a path from the build's folder, and a checksum of what was compiled beside it
# (CCACHE_PCH_EXTSUM): the compiler cache serves every clone.

function(haarlight_precompile NAME)
  if(NOT HAARLIGHT_PRECOMPILED)
    return()
  endif()
  set(header headers/${NAME}.h)
  configure_file(${PROJECT_SOURCE_DIR}/cmake/${NAME}_headers.h ${PROJECT_BINARY_DIR}/${header} COPYONLY)
  separate_arguments(flags UNIX_COMMAND "${CMAKE_CXX_FLAGS}")
  get_property(options DIRECTORY PROPERTY COMPILE_OPTIONS)
  get_target_property(eigen Eigen3::Eigen INTERFACE_INCLUDE_DIRECTORIES)
  set(command ${CMAKE_CXX_COMPILER} -std=c++20 ${flags} ${options} ${ARGN} -ffp-contract=off -isystem ${eigen})
  add_custom_command(
    OUTPUT ${PROJECT_BINARY_DIR}/${header}.pch
    COMMAND ${command} -x c++-header ${header} -MD -MF ${header}.d -MT ${header}.pch -o ${header}.pch
    COMMAND ${command} -E -P ${header} | sha256sum > ${header}.pch.sum
    DEPENDS ${PROJECT_BINARY_DIR}/${header}
    DEPFILE ${PROJECT_BINARY_DIR}/${header}.d
    WORKING_DIRECTORY ${PROJECT_BINARY_DIR}
    VERBATIM)
  add_custom_target(headers_${NAME} DEPENDS ${PROJECT_BINARY_DIR}/${header}.pch)
endfunction()

function(haarlight_use_headers TARGET NAME)
  if(NOT HAARLIGHT_PRECOMPILED)
    return()
  endif()
  target_compile_options(${TARGET} PRIVATE "SHELL:-include headers/${NAME}.h")
  add_dependencies(${TARGET} headers_${NAME})
  get_target_property(sources ${TARGET} SOURCES)
  set_property(SOURCE ${sources} APPEND PROPERTY OBJECT_DEPENDS ${PROJECT_BINARY_DIR}/headers/${NAME}.h.pch)
endfunction()
