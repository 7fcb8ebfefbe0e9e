# SPDX-License-Identifier: Apache-2.0
# What `cmake --install` puts where; docs/reference/service.md has the table. Components:
#   runtime       haarlight, and what the other programs need, too: the pages, LICENSE and NOTICE
#   daemon        haarlightd, its unit for systemd, the user it runs as, udev rules
#   sim           haarlight-sim
#   data          examples: rigs, plans, scenes, environments, controller profiles
#   doc           documents
#   development   libraries, headers, haarlightConfig.cmake
# A program's man pages and completions come with it.

set(share ${CMAKE_INSTALL_DATADIR}/haarlight)
install(FILES LICENSE NOTICE DESTINATION ${CMAKE_INSTALL_DOCDIR} COMPONENT runtime)
install(DIRECTORY web/ DESTINATION ${share}/web COMPONENT runtime PATTERN "README.md" EXCLUDE)
install(DIRECTORY configs/rigs configs/plans configs/scenes configs/environments configs/volumes
        DESTINATION ${share} COMPONENT data)
file(GLOB profiles CONFIGURE_DEPENDS configs/profiles/*.toml)
install(FILES ${profiles} DESTINATION ${share}/profiles COMPONENT data)
install(FILES README.md CHANGELOG.md CITATION.cff DESTINATION ${CMAKE_INSTALL_DOCDIR} COMPONENT doc)
install(DIRECTORY docs DESTINATION ${CMAKE_INSTALL_DOCDIR} COMPONENT doc)

# haarlight_install_program(TARGET COMPONENT)   with what is made of its --help
function(haarlight_install_program TARGET COMPONENT)
  install(TARGETS ${TARGET} RUNTIME DESTINATION ${CMAKE_INSTALL_BINDIR} COMPONENT ${COMPONENT})
  set(made ${PROJECT_BINARY_DIR}/made_of_help/${TARGET})
  install(CODE "
    file(REMOVE_RECURSE \"${made}\")
    execute_process(
      COMMAND python3 \"${PROJECT_SOURCE_DIR}/scripts/make_man\" \"${made}/man\" \"$<TARGET_FILE:${TARGET}>\"
      RESULT_VARIABLE failed ERROR_VARIABLE why OUTPUT_QUIET)
    if(failed)
      message(FATAL_ERROR \"the man pages of ${TARGET} were not made: \${why}\")
    endif()
    foreach(section 1 8)
      file(GLOB pages \"${made}/man/*.\${section}\")
      if(pages)
        file(INSTALL \${pages} DESTINATION \"\${CMAKE_INSTALL_PREFIX}/${CMAKE_INSTALL_MANDIR}/man\${section}\")
      endif()
    endforeach()
    foreach(shell bash zsh fish)
      execute_process(COMMAND \"$<TARGET_FILE:${TARGET}>\" --completions \${shell}
                      OUTPUT_FILE \"${made}/\${shell}\" COMMAND_ERROR_IS_FATAL ANY)
    endforeach()
    set(share \"\${CMAKE_INSTALL_PREFIX}/${CMAKE_INSTALL_DATADIR}\")
    file(INSTALL \"${made}/bash\" DESTINATION \"\${share}/bash-completion/completions\" RENAME ${TARGET})
    file(INSTALL \"${made}/zsh\" DESTINATION \"\${share}/zsh/site-functions\" RENAME _${TARGET})
    file(INSTALL \"${made}/fish\" DESTINATION \"\${share}/fish/vendor_completions.d\"
         RENAME ${TARGET}.fish)"
    COMPONENT ${COMPONENT})
endfunction()

haarlight_install_program(haarlight runtime)
if(HAARLIGHT_SIM)
  haarlight_install_program(haarlight-sim sim)
endif()
if(HAARLIGHT_DAEMON)
  haarlight_install_program(haarlightd daemon)
  # The unit names the folder of the programs, known only when it is installed.
  install(CODE "
    set(BINDIR \"\${CMAKE_INSTALL_PREFIX}/${CMAKE_INSTALL_BINDIR}\")
    configure_file(\"${PROJECT_SOURCE_DIR}/configs/systemd/haarlightd.service.in\"
                   \"${PROJECT_BINARY_DIR}/haarlightd.service\" @ONLY)"
    COMPONENT daemon)
  install(FILES ${PROJECT_BINARY_DIR}/haarlightd.service DESTINATION lib/systemd/system
          COMPONENT daemon)
  install(FILES configs/systemd/haarlight.sysusers DESTINATION lib/sysusers.d RENAME haarlight.conf
          COMPONENT daemon)
  file(GLOB rules CONFIGURE_DEPENDS configs/udev/*.rules)
  install(FILES ${rules} DESTINATION lib/udev/rules.d COMPONENT daemon)
endif()
haarlight_install_package()
