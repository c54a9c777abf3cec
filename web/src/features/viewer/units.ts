// Units of the fields of well-known message types, as their definitions name them.
import type { PlotCurve } from "./plot_curves";
import { derivationOf } from "@/recordings/curves/derivation_text";

type Units = readonly (readonly [fields: RegExp, unit: string])[];

const VECTOR = String.raw`(\.[xyz])?$`;
const TWIST: Units = [[new RegExp(`(^|\\.)linear${VECTOR}`), "m/s"], [new RegExp(`(^|\\.)angular${VECTOR}`), "rad/s"]];
const POSE: Units = [[new RegExp(`(^|\\.)position${VECTOR}`), "m"]];
const LOCATION: Units = [[/^(latitude|longitude)$/, "°"], [/^altitude$/, "m"], [/^position_covariance\[/, "m²"]];
const RANGES: Units = [[/^angle_|^field_of_view$/, "rad"], [/^(range|ranges|range_min|range_max|min_range|max_range)(\[|$)/, "m"], [/^(time_increment|scan_time)$/, "s"]];

/** By type, without the `msg/` of ROS 2. Joints are rotary or linear: the definition leaves it open. */
const UNITS: Readonly<Record<string, Units>> = {
  "sensor_msgs/Imu": [[new RegExp(`^linear_acceleration${VECTOR}`), "m/s²"], [new RegExp(`^angular_velocity${VECTOR}`), "rad/s"]],
  "sensor_msgs/NavSatFix": LOCATION,
  "sensor_msgs/MagneticField": [[new RegExp(`^magnetic_field${VECTOR}`), "T"]],
  "sensor_msgs/FluidPressure": [[/^fluid_pressure$/, "Pa"]],
  "sensor_msgs/Temperature": [[/^temperature$/, "°C"]],
  "sensor_msgs/Illuminance": [[/^illuminance$/, "lx"]],
  "sensor_msgs/BatteryState": [[/^(voltage|cell_voltage\[\d+\])$/, "V"], [/^current$/, "A"], [/^(charge|capacity|design_capacity)$/, "Ah"], [/^(temperature|cell_temperature\[\d+\])$/, "°C"]],
  "sensor_msgs/JointState": [[/^position\[/, "rad or m"], [/^velocity\[/, "rad/s or m/s"], [/^effort\[/, "Nm or N"]],
  "sensor_msgs/LaserScan": RANGES,
  "sensor_msgs/Range": RANGES,
  "nav_msgs/Odometry": [...POSE, ...TWIST],
  "geometry_msgs/Point": [[/^[xyz]?$/, "m"]],
  "geometry_msgs/PointStamped": [[new RegExp(`^point${VECTOR}`), "m"]],
  "geometry_msgs/Pose": POSE,
  "geometry_msgs/PoseStamped": POSE,
  "geometry_msgs/PoseWithCovarianceStamped": POSE,
  "geometry_msgs/TransformStamped": [[new RegExp(`^transform\\.translation${VECTOR}`), "m"]],
  "geometry_msgs/Twist": TWIST,
  "geometry_msgs/TwistStamped": TWIST,
  "geometry_msgs/TwistWithCovarianceStamped": TWIST,
  "geometry_msgs/AccelStamped": [[new RegExp(`(^|\\.)linear${VECTOR}`), "m/s²"], [new RegExp(`(^|\\.)angular${VECTOR}`), "rad/s²"]],
  "geometry_msgs/Wrench": [[new RegExp(`^force${VECTOR}`), "N"], [new RegExp(`^torque${VECTOR}`), "Nm"]],
  "geometry_msgs/WrenchStamped": [[new RegExp(`^wrench\\.force${VECTOR}`), "N"], [new RegExp(`^wrench\\.torque${VECTOR}`), "Nm"]],
  "foxglove.LocationFix": LOCATION,
  "foxglove_msgs/LocationFix": LOCATION,
};

const PER_SECOND: Readonly<Record<string, string>> = { m: "m/s", "m/s": "m/s²", "m/s²": "m/s³", rad: "rad/s", "rad/s": "rad/s²", "rad/s²": "rad/s³" };

/** Returns the unit of a field; null where it is not known. */
export function unitOf(messageType: string | null, path: string): string | null {
  const name = (messageType ?? "").replace("/msg/", "/");
  const units = Object.hasOwn(UNITS, name) ? UNITS[name] : undefined;
  return units?.find(([fields]) => fields.test(path))?.[1] ?? null;
}

/** Returns the unit of a curve; `typeOf` returns the message type of a topic. */
export function unitOfCurve({ column, minus }: PlotCurve, messageType: string | null, typeOf: (recording: string, topic: string) => string | null): string | null {
  if (minus !== null) return ifEqual(unitOf(messageType, column), unitOf(typeOf(minus.recording, minus.topic), minus.field));
  const derivation = derivationOf(column);
  if (derivation === null) return unitOf(messageType, column);
  const [first = "", second = ""] = derivation.parts;
  const unit = unitOf(messageType, first);
  if (derivation.name === "difference") return ifEqual(unit, unitOf(messageType, second));
  return derivation.name === "norm" || unit === null ? unit : (PER_SECOND[unit] ?? `(${unit})/s`);
}

function ifEqual(one: string | null, other: string | null): string | null {
  return one === other ? one : null;
}
