# What `cmake --install` puts where: programs, the daemon's page, its unit for systemd, the user it
# runs as, udev rules, examples and man pages. docs/service.md walks through it.

include(GNUInstallDirs)
install(TARGETS haarlight haarlightd haarlight-sim RUNTIME DESTINATION ${CMAKE_INSTALL_BINDIR})
install(DIRECTORY web/ DESTINATION ${CMAKE_INSTALL_DATADIR}/haarlight/web
        PATTERN "README.md" EXCLUDE)
install(DIRECTORY configs/rigs configs/plans DESTINATION ${CMAKE_INSTALL_DATADIR}/haarlight)
file(GLOB profiles CONFIGURE_DEPENDS configs/profiles/*.toml)
install(FILES ${profiles} DESTINATION ${CMAKE_INSTALL_DATADIR}/haarlight/profiles)
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
