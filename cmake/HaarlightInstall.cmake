# SPDX-License-Identifier: Apache-2.0
# What `cmake --install` puts where: programs, the daemon's page, its unit for systemd, the user it
# runs as, udev rules, examples and man pages. docs/reference/service.md walks through it.

include(GNUInstallDirs)
set(programs haarlight)
if(HAARLIGHT_DAEMON)
  list(APPEND programs haarlightd)
endif()
if(HAARLIGHT_SIM)
  list(APPEND programs haarlight-sim)
endif()
install(TARGETS ${programs} RUNTIME DESTINATION ${CMAKE_INSTALL_BINDIR})
install(DIRECTORY web/ DESTINATION ${CMAKE_INSTALL_DATADIR}/haarlight/web
        PATTERN "README.md" EXCLUDE)
install(DIRECTORY configs/rigs configs/plans configs/scenes configs/environments
        DESTINATION ${CMAKE_INSTALL_DATADIR}/haarlight)
file(GLOB profiles CONFIGURE_DEPENDS configs/profiles/*.toml)
install(FILES ${profiles} DESTINATION ${CMAKE_INSTALL_DATADIR}/haarlight/profiles)
install(FILES LICENSE NOTICE DESTINATION ${CMAKE_INSTALL_DOCDIR})
# The unit names the folder of the programs, known only when it is installed.
install(CODE "
  set(BINDIR \"\${CMAKE_INSTALL_PREFIX}/${CMAKE_INSTALL_BINDIR}\")
  configure_file(\"${PROJECT_SOURCE_DIR}/configs/systemd/haarlightd.service.in\"
                 \"${PROJECT_BINARY_DIR}/haarlightd.service\" @ONLY)")
install(FILES ${PROJECT_BINARY_DIR}/haarlightd.service DESTINATION lib/systemd/system)
install(FILES configs/systemd/haarlight.sysusers DESTINATION lib/sysusers.d
        RENAME haarlight.conf)
file(GLOB rules CONFIGURE_DEPENDS configs/udev/*.rules)
install(FILES ${rules} DESTINATION lib/udev/rules.d)
# The man pages say what the programs' --help says.
list(TRANSFORM programs REPLACE "(.+)" "\"$<TARGET_FILE:\\1>\"" OUTPUT_VARIABLE files)
list(JOIN files " " files)
install(CODE "
  execute_process(
    COMMAND python3 \"${PROJECT_SOURCE_DIR}/scripts/make_man\" \"${PROJECT_BINARY_DIR}/man\"
            ${files}
    RESULT_VARIABLE failed ERROR_VARIABLE why OUTPUT_QUIET)
  if(failed)
    message(FATAL_ERROR \"the man pages were not made: \${why}\")
  endif()
  file(GLOB pages1 \"${PROJECT_BINARY_DIR}/man/*.1\")
  file(GLOB pages8 \"${PROJECT_BINARY_DIR}/man/*.8\")
  file(INSTALL \${pages1} DESTINATION \"\${CMAKE_INSTALL_PREFIX}/${CMAKE_INSTALL_MANDIR}/man1\")
  file(INSTALL \${pages8} DESTINATION \"\${CMAKE_INSTALL_PREFIX}/${CMAKE_INSTALL_MANDIR}/man8\")")
