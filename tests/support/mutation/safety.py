"""Faults in the safety layers between a policy and a robot."""

from __future__ import annotations

from .mutant import Mutant

_REAL = "envs/shape_obs_envs/real"
_REAL_TESTS = "tests/shape_obs_envs/real"
#: Modules of ``shape_obs/deploy`` that other files than ``test_loop.py`` test.
_TESTS = {"supervision": "supervision", "run_log": "run_log"}


def _reader(name: str, old: str, new: str, *tests: str) -> Mutant:
    return Mutant(
        f"safety: {name}", f"{_REAL}/frame_reader.py", old, new, tests or (f"{_REAL_TESTS}/test_frame_reader.py",)
    )


def _lock(name: str, old: str, new: str) -> Mutant:
    return Mutant(f"safety: {name}", f"{_REAL}/interlock.py", old, new, (f"{_REAL_TESTS}/test_interlock.py",))


def _cell(name: str, old: str, new: str) -> Mutant:
    tests = (f"{_REAL_TESTS}/test_interlock.py", f"{_REAL_TESTS}/test_env.py")
    return Mutant(f"safety: {name}", f"{_REAL}/env.py", old, new, tests)


def _deploy(name: str, module: str, old: str, new: str, *tests: str, equivalent: str = "") -> Mutant:
    files = tests or (f"tests/deploy/test_{_TESTS.get(module, 'loop')}.py",)
    return Mutant(f"safety: {name}", f"shape_obs/deploy/{module}.py", old, new, files, equivalent)


def _guard(name: str, old: str, new: str) -> Mutant:
    return Mutant(f"safety: {name}", "shape_obs/servo/action_limiter.py", old, new, (f"{_REAL_TESTS}/test_env.py",))


SAFETY: tuple[Mutant, ...] = (
    _reader("frames of any age are taken", "max_age=max(0.0, time.monotonic() - moment)", "max_age=1e9"),
    _reader("queued frames are taken", "frame.received >= moment", "frame.received >= 0"),
    _reader("a moment to come is not waited for", "max_age=max(0.0, time.monotonic() - moment)",
         "max_age=abs(time.monotonic() - moment)"),
    _reader("recordings are waited for", " or not self.source.live:", ":"),
    _reader("late frames count as exposed when they came", "frame.received - self.lag(frame)\n",
         "frame.received\n", f"{_REAL_TESTS}/test_interlock.py"),
    _reader("the camera's own time of exposure is ignored",
         "arrived if frame.exposed is None else min(frame.exposed, arrived)", "arrived",
         f"{_REAL_TESTS}/test_interlock.py"),

    _lock("motions whose time is over are sent", '"image old" if time.monotonic() >= until else ""', '""'),
    _lock("motions are sent after a trip", 'return self.tripped or ("image old"', 'return ("image old"'),
    _lock("a send that was blocked is not looked at again",
          "            refusal = self._refusal(until)  # `send` may", "            # `send` may"),
    _lock("no motion expires", "            self._expect_end(until)\n", ""),
    _lock("an expired motion goes on", "            self.expired += 1\n            self._stop_robot()",
          "            self.expired += 1"),
    _lock("a motion that was stopped expires", "        self._expect_end(math.inf)\n", ""),
    _lock("a trip does not last", "        self.tripped = self.tripped or reason\n", ""),
    _lock("a trip does not stop", "or reason\n        self._stop_robot()", "or reason"),
    _lock("a robot that does not stop is no error", "            self._failure = error", "            pass"),
    _lock("it stays tripped", 'self.tripped, self._failure = "", None', "pass"),

    _cell("motions last from when they are sent", "self._exposed + self.max_age", "time.monotonic() + self.max_age"),
    _cell("None moves on", "            self.interlock.stop()\n            return", "            return"),
    _cell("what was withheld is not reported", '            info["withheld"] = self.withheld', "            pass"),
    _cell("any robot will do", "            check_robot(self.robot)\n", ""),

    _deploy("an old shape is good enough", "safety", "or not age <= 0:", "or age > 1e9:"),
    _deploy("a shape of unknown age is good enough", "safety", "or not age <= 0:", "or age > 0:"),
    _deploy("a lost shape is good enough", "safety", 'not info.get("shape/ok", False) or', "False or"),
    _deploy("missing points do not matter", "safety", "if fractions and min(fractions)",
            "if not fractions and min(fractions)"),
    _deploy("old images do not matter", "safety", "if not age <= limits.max_age:", "if False:"),
    _deploy("images of unknown age do not matter", "safety", "if not age <= limits.max_age:",
            "if age > limits.max_age:"),
    _deploy("a lost shape is waited for without end", "safety", "if waited > self._limits.hold:", "if False:"),
    _deploy("all waits count together", "safety", "            self._since = None\n            return",
            "            return"),
    _deploy("the watchdog only looks", "loop", 'lambda: interlock.trip("watchdog")', "lambda: None"),
    _deploy("errors of camera and robot are ignored", "loop", "if errors:", "if False:"),
    _deploy("nothing stops at the end of the loop", "loop", "                interlock.stop()\n            finally:",
            "                pass\n            finally:",
            equivalent="`supervised` stops the robot right after; this one comes before the report is made."),
    _deploy("the limit of age stays the environment's", "loop", "self._robot_env.max_age = limits.max_age", "pass",
            f"{_REAL_TESTS}/test_interlock.py"),
    _deploy("a withheld motion counts as sent", "loop", "if robot_env.withheld:", "if False:",
            f"{_REAL_TESTS}/test_interlock.py"),
    _deploy("no report after an exception", "loop", "                    self._log.report(",
            "                    str(", "tests/deploy/test_run_log.py"),
    _deploy("the watchdog sleeps", "safety", "if left <= 0:", "if left <= -1e9:"),
    _deploy("signals do not stop", "supervision", "self._stop(signal.Signals(signum).name)", "pass",
            "tests/deploy/test_stops.py"),
    _deploy("signals do not end the run", "supervision", "            raise Interrupted(signum)", "            pass"),
    _deploy("a closed terminal kills", "supervision", '"SIGHUP", ', ""),
    _deploy("ignored signals are taken", "supervision", "is not signal.SIG_IGN", "is not None"),
    _deploy("handlers are left behind", "supervision",
            "signal.signal(signum, signal.SIG_DFL if handler is None else handler)", "pass"),
    _deploy("a second signal parks", "supervision", "if len(signals.received) > 1:", "if False:"),
    _deploy("parking cannot be ended", "supervision", "signals.raising = True", "signals.raising = False"),
    _deploy("no parking", "supervision", "            if park:", "            if False:",
            "tests/deploy/test_loop.py"),
    _deploy("steps wait for the disk", "run_log", "        self._tasks.put(lambda: self._write_step(record))",
            "        self._write_step(record)"),
    _deploy("a full disk goes unnoticed", "run_log", "            self._failure = self._failure or error",
            "            pass"),

    _deploy("the watchdog is never fed", "safety", "        self._fed = time.monotonic()\n\n", "        pass\n\n"),
    _guard("actions are not clipped", "np.clip(action, -1.0, 1.0)", "action"),
    _guard("steps are not capped", "np.clip(step, -self.max_step, self.max_step)", "step"),
    _guard("velocities are per step", '"velocity": dt', '"velocity": 1.0'),
    _guard("the workspace has no end", "np.minimum(self.low, state), np.maximum(self.high, state)", "-9e9, 9e9"),
)  # fmt: skip
