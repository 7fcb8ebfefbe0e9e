# SPDX-License-Identifier: Apache-2.0
# System headers compiled once for all sources: a third of a small source's time, and with clang
# half. A source that forgets an include compiles all the same: clang-tidy reads it without them.
#
# haarlight_precompile(NAME [FLAG ...])   compiles cmake/NAME_headers.h with these flags
# haarlight_use_headers(TARGET NAME)      TARGET's sources begin with it
#
# -include by a path from the build's folder, and a checksum of what was compiled beside it
# (CCACHE_PCH_EXTSUM): the compiler cache serves every clone.

if(CMAKE_CXX_COMPILER_ID STREQUAL "GNU")
  set(HAARLIGHT_PRECOMPILED_SUFFIX gch)
else()
  set(HAARLIGHT_PRECOMPILED_SUFFIX pch)
endif()

function(haarlight_precompile NAME)
  if(NOT HAARLIGHT_PRECOMPILED)
    return()
  endif()
  set(header headers/${NAME}.h)
  set(compiled ${header}.${HAARLIGHT_PRECOMPILED_SUFFIX})
  configure_file(${PROJECT_SOURCE_DIR}/cmake/${NAME}_headers.h ${PROJECT_BINARY_DIR}/${header} COPYONLY)
  string(TOUPPER "${CMAKE_BUILD_TYPE}" type)
  separate_arguments(flags UNIX_COMMAND "${CMAKE_CXX_FLAGS} ${CMAKE_CXX_FLAGS_${type}}")
  get_property(options DIRECTORY PROPERTY COMPILE_OPTIONS)
  get_target_property(eigen Eigen3::Eigen INTERFACE_INCLUDE_DIRECTORIES)
  # The warnings, too: g++ defines a macro more without them, and refuses the file then.
  set(command ${CMAKE_CXX_COMPILER} -std=c++20 ${flags} ${options}
              $<TARGET_PROPERTY:haarlight_warnings,INTERFACE_COMPILE_OPTIONS> ${ARGN} -isystem ${eigen})
  add_custom_command(
    OUTPUT ${PROJECT_BINARY_DIR}/${compiled}
    COMMAND ${command} -x c++-header ${header} -MD -MF ${header}.d -MT ${compiled} -o ${compiled}
    COMMAND ${command} -x c++-header -E -P ${header} -o ${header}.whole
    COMMAND sha256sum ${header}.whole > ${compiled}.sum
    DEPENDS ${PROJECT_BINARY_DIR}/${header}
    DEPFILE ${PROJECT_BINARY_DIR}/${header}.d
    WORKING_DIRECTORY ${PROJECT_BINARY_DIR}
    COMMAND_EXPAND_LISTS
    VERBATIM)
  add_custom_target(headers_${NAME} DEPENDS ${PROJECT_BINARY_DIR}/${compiled})
endfunction()

function(haarlight_use_headers TARGET NAME)
  if(NOT HAARLIGHT_PRECOMPILED)
    return()
  endif()
  # g++ says nothing of a file that it does not use, but for the warning; the compiler cache asks for
  # -fpch-preprocess.
  target_compile_options(${TARGET} PRIVATE
    "SHELL:-include headers/${NAME}.h"
    $<$<CXX_COMPILER_ID:GNU>:-Winvalid-pch> $<$<CXX_COMPILER_ID:GNU>:-fpch-preprocess>)
  add_dependencies(${TARGET} headers_${NAME})
  get_target_property(sources ${TARGET} SOURCES)
  set_property(SOURCE ${sources} APPEND PROPERTY OBJECT_DEPENDS
               ${PROJECT_BINARY_DIR}/headers/${NAME}.h.${HAARLIGHT_PRECOMPILED_SUFFIX})
endfunction()
