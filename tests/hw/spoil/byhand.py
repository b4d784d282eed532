"""Dangerous slips that a person might make, on the board and on the host."""

from __future__ import annotations

from tests.hw.spoil.spoiling import BOARD, FIRMWARE, Slip

_BOARD, _MOTORS, _LINK = f"{FIRMWARE}/board.cpp", f"{FIRMWARE}/motors.cpp", f"{FIRMWARE}/link.cpp"
_FRAMES, _MEMORY = f"{FIRMWARE}/frames.cpp", f"{FIRMWARE}/memory.cpp"
_GUARD = "tepm_opt/hw/guard.py"

FIRMWARE_SLIPS = (
    # faults and stops
    Slip("a first fault hides those after it", _BOARD, "  if (faults_ & bit) return;\n", "  if (faults_) return;\n"),
    Slip(
        "REGULATOR does not drop OUTPUTS",
        _BOARD,
        "if (fault >= Fault::MONITOR) outputs_off",
        "if (fault >= Fault::MONITOR && fault != Fault::REGULATOR) outputs_off",
    ),
    Slip("MONITOR does not drop OUTPUTS", _BOARD, "if (fault >= Fault::MONITOR) outputs_off", "if (fault > Fault::MONITOR) outputs_off"),
    Slip(
        "LOOP_HUNG does not drop OUTPUTS",
        _BOARD,
        "if (fault >= Fault::MONITOR) outputs_off",
        "if (fault >= Fault::MONITOR && fault < Fault::LOOP_HUNG) outputs_off",
    ),
    Slip("ESTOP does not drop OUTPUTS", _BOARD, "  leave(State::ESTOP);\n  outputs_off();\n", "  leave(State::ESTOP);\n"),
    Slip(
        "a fault while idle is told and not acted on",
        _BOARD,
        "  if (state_ != State::ESTOP) leave(State::FAULT);",
        "  if (state_ == State::ARMED) leave(State::FAULT);",
    ),
    Slip("leaving ARMED keeps the pressure", _BOARD, "  for (uint8_t k = 0; k < CHANNELS; ++k) wanted_pressure[k] = 0;\n", ""),
    Slip(
        "DACs keep their codes while the outputs are off",
        _BOARD,
        "  for (uint8_t k = 0; k < DACS; ++k) dac::write(k, applied[k] = code_[k] = 0);\n",
        "",
    ),
    Slip("a reset while armed is forgotten", _BOARD, "  memory::armed(true);\n", ""),
    Slip("a reset while idle is a fault", _BOARD, "  memory::armed(false);\n", ""),
    # what is measured
    Slip(
        "regulators are watched only while armed",
        _BOARD,
        "  if (MONITORS == 0) return;\n",
        "  if (MONITORS == 0 || state_ != State::ARMED) return;\n",
    ),
    Slip("nobody looks whether a pressure is too high", _BOARD, "  if (over[k].reaches(", "  if (false && over[k].reaches("),
    Slip("nobody looks whether a monitor is broken", _BOARD, "  if (broken[k].reaches(", "  if (false && broken[k].reaches("),
    Slip("nobody looks whether a regulator follows", _BOARD, "  if (stuck[k].reaches(", "  if (false && stuck[k].reaches("),
    Slip(
        "one good sample of a monitor clears its counters",
        _BOARD,
        "    value = value > fall ? value - fall : 0;\n",
        "    value = 0 * fall;\n",
    ),
    Slip("one good sample of a dynamometer clears its counter", _BOARD, "    --dead[k];\n", "    dead[k] = 0;\n"),
    Slip("a sample that jumps is believed", _BOARD, "  lost[k] = out || change > JUMP;", "  lost[k] = out || change > 0x7FFF;"),
    Slip("the tension loop goes on while a dynamometer is lost", _BOARD, "way = close || lost[k] ? 0", "way = close ? 0"),
    Slip("travel forwards is not watched", _BOARD, "motors::position(k) > TRAVEL_MAX || ", ""),
    Slip("travel backwards is not watched", _BOARD, " || motors::position(k) < -TRAVEL_MAX", ""),
    Slip("voltages below zero wrap round", f"{FIRMWARE}/adc.cpp", "value & 0x8000 ? 0 : value", "value & 0x7FFF"),
    # set points
    Slip("a repeated SET is a sign of life", _BOARD, "message.sequence <= sequence_", "message.sequence < sequence_"),
    Slip("a SET of another session is done", _BOARD, " || message.session != memory::session() ||", " ||"),
    Slip("the session stays when the board is disarmed", _BOARD, "  if (state_ == State::ARMED) new_session();\n", ""),
    Slip("any SET is a sign of life", _BOARD, "    ++stale_;\n", "    ++stale_;\n    heard = now;\n"),
    Slip("a refused set point is a sign of life", _BOARD, "    ++refused_;\n", "    ++refused_;\n    heard = now;\n"),
    Slip("tensions below zero are allowed", _BOARD, " && message.tendons[k] >= 0", ""),
    Slip("steps are held to the limit of tensions", _BOARD, "steps ? LIMITS.position_max : LIMITS.tension_max", "LIMITS.tension_max"),
    Slip("the last clamp before the DACs is gone", _BOARD, "  if (code_[k] > LIMITS.pressure_max) code_[k] = LIMITS.pressure_max;\n", ""),
    Slip("time limits count passes, not time", _BOARD, "  now = motors::time();\n", "  ++now;\n"),
    Slip("the host may be silent for 200 ms", f"{FIRMWARE}/config.h", "TIMEOUT_MS = 100;", "TIMEOUT_MS = 200;"),
    # ARM, CLEAR and the button
    Slip("the emergency stop has no pull-up", _BOARD, "  ESTOP_PORT |= _BV(ESTOP_BIT);", "  "),
    Slip(
        "the emergency stop counts only while armed",
        _BOARD,
        "if (estop_pressed() && state_ != State::ESTOP)",
        "if (estop_pressed() && state_ == State::ARMED)",
    ),
    Slip(
        "ARM while the emergency stop is pressed",
        _BOARD,
        "  if (estop_pressed()) return Result::ESTOP_PRESSED;\n  if (state_ != State::IDLE)",
        "  if (state_ != State::IDLE)",
    ),
    Slip("ARM while a monitor disagrees", _BOARD, "  if (channel < DACS) return Result::MONITOR;\n  for", "  for"),
    Slip("ARM without looking at the dynamometers", _BOARD, "    if (dynamometer_dead(channel)) return Result::DYNAMOMETER;\n", ""),
    Slip("ARM with other limits", _BOARD, "  if (message.limits != limits_check) return Result::WRONG_LIMITS;\n", ""),
    Slip("ARM of another session", _BOARD, "  if (message.session != memory::session()) return Result::WRONG_SESSION;\n", ""),
    Slip("CLEAR while armed", _BOARD, "  if (state_ == State::ARMED) return Result::WRONG_STATE;\n", ""),
    Slip(
        "CLEAR while the emergency stop is pressed",
        _BOARD,
        "  if (state_ == State::ARMED) return Result::WRONG_STATE;\n  if (estop_pressed()) return Result::ESTOP_PRESSED;\n",
        "  if (state_ == State::ARMED) return Result::WRONG_STATE;\n",
    ),
    Slip("CLEAR while a monitor disagrees", _BOARD, "  if (channel < DACS) return Result::MONITOR;\n  motors", "  motors"),
    Slip("CLEAR keeps faults", _BOARD, "  faults_ = 0;\n", ""),
    # sessions
    Slip(
        "sessions begin anew after a power cut",
        _MEMORY,
        "  session_ = (uint32_t)count_start(lower) << 16 | lower;\n",
        "  count_start(lower);\n  session_ = 1;\n",
    ),
    Slip(
        "starts are not counted in the EEPROM",
        _MEMORY,
        "eeprom_write_block(&last, &starts[at + 1 < PLACES ? at + 1 : 0], sizeof last);",
        "(void)at;",
    ),
    Slip("a start has the number of the one before", _MEMORY, "number = last.number + 1;", "number = last.number;"),
    # motors and interrupts
    Slip("the time is read with interrupts on", _MOTORS, "  cli();\n  const uint32_t value = passed;", "  const uint32_t value = passed;"),
    Slip("motors are switched with interrupts on", _MOTORS, "  cli();\n  ENA_PORT =", "  ENA_PORT ="),
    Slip("monitors are read with interrupts on", f"{FIRMWARE}/adc.cpp", "  cli();\n  const uint16_t sum", "  const uint16_t sum"),
    Slip("a hung loop is no fault", _BOARD, "  if (motors::hung()) fail(Fault::LOOP_HUNG);\n", ""),
    Slip("the interrupt forgets that the loop hung", _MOTORS, "if (patience && !hung_) {", "if (patience) {"),
    Slip("motors are switched on though the loop hung", _MOTORS, "  if (hung_) bits = 0;\n", ""),
    Slip("a hung loop keeps the motors on", _MOTORS, "    ENA_PORT |= ALL << ENA_SHIFT;\n    CONTROL_PORT", "    CONTROL_PORT"),
    Slip("a hung loop keeps the outputs on", _MOTORS, "    CONTROL_PORT &= ~_BV(OUTPUTS_BIT);\n", ""),
    Slip("a hung loop goes on stepping", _MOTORS, "    hung_ = true;\n    steps = 0;\n", "    hung_ = true;\n"),
    Slip("a motor that is switched off ends its millisecond", _MOTORS, "steps[tick] & enabled_;", "steps[tick];"),
    Slip("ENA is an output before it is off", _MOTORS, "  ENA_PORT |= ALL << ENA_SHIFT;  // off, before the pins are outputs\n", ""),
    Slip(
        "a pass that was not written is played again",
        _MOTORS,
        "    memset(passes[playing].steps, 0, TICKS);\n    ++missed_;",
        "    ++missed_;",
    ),
    Slip("the watchdog is never switched on", f"{FIRMWARE}/tepm.cpp", "  wdt_enable(WDTO_120MS);\n", ""),
    Slip("a hung loop feeds the watchdog", _MOTORS, "  ++passed;\n", '  ++passed;\n  __asm__ volatile("wdr");\n'),
    # the line
    Slip("ESTOP counts only while armed", _BOARD, "Result estop() {\n  stop();", "Result estop() {\n  if (state_ == State::ARMED) stop();"),
    Slip("a request that comes again is done again", _LINK, "  if (!memcmp(last, &message, sizeof message)) return true;\n", ""),
    Slip("messages of any length are taken", _LINK, " && decoder.length() == sizeof(Message)", ""),
    Slip("frames with a wrong CRC are taken", _FRAMES, " && crc_ == RIGHT;", ";"),
    Slip(
        "the CRC begins at 0 everywhere",
        _FRAMES,
        "  crc_ = 0xFFFF;\n",
        "  crc_ = 0;\n",
        (
            Slip("", _LINK, "  crc = 0xFFFF;\n", "  crc = 0;\n"),
            Slip("", f"{BOARD}/protocol.py", "binascii.crc_hqx(payload, 0xFFFF) ^ 0xFFFF", "binascii.crc_hqx(payload, 0) ^ 0xFFFF"),
        ),
    ),
    Slip(
        "the CRC begins at 0 and is sent as it is",
        _FRAMES,
        "  crc_ = 0xFFFF;\n",
        "  crc_ = 0;\n",
        (
            Slip("", _FRAMES, "RIGHT = 0x1D0F;", "RIGHT = 0;"),
            Slip("", _LINK, "  crc = 0xFFFF;\n", "  crc = 0;\n"),
            Slip("", _LINK, "    crc = ~crc;\n", ""),
            Slip("", f"{BOARD}/protocol.py", "binascii.crc_hqx(payload, 0xFFFF) ^ 0xFFFF", "binascii.crc_hqx(payload, 0)"),
        ),
    ),
    Slip("the decoder writes behind its buffer", _FRAMES, "if (length_ >= LONGEST) {", "if (length_ > LONGEST + 1) {"),
)

HOST_SLIPS = (
    Slip("stale measurements are given as fresh", f"{BOARD}/rig.py", " and self._clock() - status.time <= STALE:", ":"),
    Slip(
        "no ESTOP where DISARM is not answered",
        f"{BOARD}/rig.py",
        "            self.link.request(ESTOP)\n\n    def emergency_stop",
        "            raise\n\n    def emergency_stop",
    ),
    Slip(
        "a stopped rig arms again",
        f"{BOARD}/rig.py",
        "        armed, self._armed = self._armed, False\n",
        "        armed, self._armed = self._armed, None\n",
    ),
    Slip(
        "a board that stopped is armed again",
        f"{BOARD}/rig.py",
        "        self._armed = False\n        for kind in",
        "        self._armed = None\n        for kind in",
    ),
    Slip(
        "nobody notices that the board stopped",
        f"{BOARD}/link.py",
        "                if status.state is not State.ARMED:\n",
        "                if status.state is State.IDLE:\n",
    ),
    Slip("a board that says nothing is sent set points", f"{BOARD}/link.py", "if silent > SILENT:", "if False:"),
    Slip(
        "a board that acts on no set point is sent more",
        f"{BOARD}/link.py",
        "if waited > SILENT and silent < SILENT / 2:",
        "if False:",
    ),
    Slip("nobody notices that set points are refused", f"{BOARD}/link.py", "if status.refused != arming.refused:", "if False:"),
    Slip("nobody notices that set points are ignored", f"{BOARD}/link.py", "if status.stale != arming.stale:", "if False:"),
    Slip(
        "a board that cannot be relied on is not disarmed",
        f"{BOARD}/rig.py",
        "        for kind in (DISARM, ESTOP):\n",
        "        for kind in ():\n",
    ),
    Slip(
        "the emergency stop only disarms",
        f"{BOARD}/rig.py",
        "        self._armed = False\n        self.link.request(ESTOP)",
        "        self._armed = False\n        self.link.request(DISARM)",
    ),
    Slip(
        "leaving by an exception does not stop",
        f"{BOARD}/rig.py",
        "            with contextlib.suppress(LinkError):\n                self.close()",
        "            self.link.close()",
    ),
    Slip(
        "an interrupted ARM is not taken back",
        f"{BOARD}/rig.py",
        "            self._armed = True  #",
        "            pass  #",
    ),
    Slip(
        "commands are not checked",
        f"{BOARD}/rig.py",
        "values = check_command(command, self.robot)",
        "values = np.concatenate([command.pressures, command.tensions, command.enabled])",
    ),
    Slip(
        "NaN passes the check of commands",
        "tepm_opt/hw/commands.py",
        "~((values >= -_ROUNDING * limits) & (values <= limits * (1 + _ROUNDING)))",
        "(values < -_ROUNDING * limits) | (values > limits * (1 + _ROUNDING))",
    ),
    Slip("a measurement that is NaN counts as one", _GUARD, "        last[np.isfinite(values)] = now\n", "        last[:] = now\n"),
    Slip("measurements that stop are not missed", _GUARD, "if (now - last > UNMEASURED_S).any():", "if False:"),
    Slip("measured tensions are not guarded", _GUARD, '        self._check_measured("tension", sample)\n', ""),
    Slip(
        "measured pressures may be half as much again",
        _GUARD,
        "self._most = {kind: (1 + margin) * limits for",
        "self._most = {kind: 1.5 * limits for",
    ),
    Slip("a rig may go on blind", _GUARD, "sample.time - self._seen > self._blind:", "sample.time < self._seen:"),
    Slip("commands below zero pass", "tepm_opt/hw/commands.py", "(values >= -_ROUNDING * limits) & ", "~np.isnan(values) & "),
    Slip("what exceeds the firmware's limit is cut off in silence", f"{BOARD}/calibration.py", "if (whole > most + 1).any():", "if False:"),
    Slip("frames with a wrong CRC are believed", f"{BOARD}/protocol.py", ' or crc(payload) != int.from_bytes(content[-2:], "big"):', ":"),
    Slip(
        "firmware and robot file may disagree",
        f"{BOARD}/rig.py",
        "if different := differences(self.robot, self.limits):",
        "if False:",
    ),
    Slip(
        "set points bear the newest session",
        f"{BOARD}/link.py",
        "self.send(SET, session=arming.session,",
        "self.send(SET, session=self._session,",
    ),
    Slip("the board's refusal is not told", f"{BOARD}/link.py", 'if answer["result"] != Result.DONE:', "if False:"),
    Slip("a request is sent only once", f"{BOARD}/link.py", "TRIES, PATIENCE = 5, 0.05", "TRIES, PATIENCE = 1, 0.25"),
    Slip("another protocol is spoken to", f"{BOARD}/link.py", "if self._hello.version != protocol.VERSION:", "if False:"),
    Slip(
        "a line that is gone looks silent",
        f"{BOARD}/link.py",
        "        except OSError as error:\n            raise _convert_to_link_error(error) from error\n        except LinkError",
        "        except OSError:\n            pass\n        except LinkError",
    ),
)

BY_HAND = {slip.name: slip for slip in (*FIRMWARE_SLIPS, *HOST_SLIPS)}
