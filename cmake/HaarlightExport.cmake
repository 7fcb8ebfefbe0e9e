# SPDX-License-Identifier: Apache-2.0
# What other projects find by find_package(haarlight): the component "development".
#
# haarlight_install_module(TARGET)   a library and its public headers, as haarlight::NAME
# haarlight_install_package()        haarlightConfig.cmake; once, after all modules

include(GNUInstallDirs)
include(CMakePackageConfigHelpers)
set(HAARLIGHT_PACKAGE_DESTINATION ${CMAKE_INSTALL_LIBDIR}/cmake/haarlight)

function(haarlight_install_module TARGET)
  get_target_property(name ${TARGET} EXPORT_NAME)
  set_property(GLOBAL APPEND PROPERTY HAARLIGHT_LIBRARIES haarlight::${name})
  install(TARGETS ${TARGET} EXPORT haarlightTargets
          ARCHIVE DESTINATION ${CMAKE_INSTALL_LIBDIR} COMPONENT development
          FILE_SET HEADERS DESTINATION ${CMAKE_INSTALL_INCLUDEDIR} COMPONENT development
          FILE_SET of_sources DESTINATION ${CMAKE_INSTALL_INCLUDEDIR} COMPONENT development)
endfunction()

function(haarlight_install_package)
  get_property(haarlight_LIBRARIES GLOBAL PROPERTY HAARLIGHT_LIBRARIES)
  configure_package_config_file(
    ${PROJECT_SOURCE_DIR}/cmake/haarlightConfig.cmake.in ${PROJECT_BINARY_DIR}/haarlightConfig.cmake
    INSTALL_DESTINATION ${HAARLIGHT_PACKAGE_DESTINATION}
    NO_SET_AND_CHECK_MACRO)
  write_basic_package_version_file(${PROJECT_BINARY_DIR}/haarlightConfigVersion.cmake
                                   COMPATIBILITY SameMinorVersion)
  install(EXPORT haarlightTargets NAMESPACE haarlight:: DESTINATION ${HAARLIGHT_PACKAGE_DESTINATION}
          COMPONENT development)
  install(FILES ${PROJECT_BINARY_DIR}/haarlightConfig.cmake
                ${PROJECT_BINARY_DIR}/haarlightConfigVersion.cmake
                ${PROJECT_SOURCE_DIR}/cmake/HaarlightDependencies.cmake
          DESTINATION ${HAARLIGHT_PACKAGE_DESTINATION} COMPONENT development)
endfunction()
