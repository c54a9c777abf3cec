// Small copies of pictures, so that a long list keeps few bytes. They are drawn by an <img>, which executes nothing of an SVG.
import type { MissionPicture, MissionThumbnail } from "./queries";
import { asPicture } from "@/features/runs/preview";

/** The longer side in device pixels. */
const SIDE = 160;

/** Returns the size of a copy; null where the picture is small enough, or has no size of its own. */
export function sizeOfCopy(width: number, height: number): { readonly width: number; readonly height: number } | null {
  const scale = SIDE / Math.max(width, height);
  if (!(scale < 1)) return null;
  return { width: Math.max(1, Math.round(width * scale)), height: Math.max(1, Math.round(height * scale)) };
}

async function copyOf(picture: Blob): Promise<Blob> {
  const address = URL.createObjectURL(picture);
  try {
    const image = new Image();
    image.src = address;
    await image.decode();
    const size = sizeOfCopy(image.naturalWidth, image.naturalHeight);
    if (size === null) return picture;
    const canvas = Object.assign(document.createElement("canvas"), size);
    canvas.getContext("2d")?.drawImage(image, 0, 0, size.width, size.height);
    return (await new Promise<Blob | null>((resolve) => canvas.toBlob(resolve))) ?? picture;
  } finally {
    URL.revokeObjectURL(address);
  }
}

/** Returns the bytes of a JPEG in base64. */
export function jpegOf(text: string): Blob {
  return new Blob([Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0))], { type: "image/jpeg" });
}

type Renew = (missionId: string) => Promise<MissionPicture | MissionThumbnail | undefined>;

/** Returns a small copy of a picture. Where its URL has expired, `renew` returns the picture with another one. */
export async function thumbnailOf(picture: MissionPicture | MissionThumbnail, renew: Renew, signal: AbortSignal): Promise<Blob> {
  if ("jpeg" in picture) return jpegOf(picture.jpeg);
  let answer = await fetch(picture.url, { signal, credentials: "omit" });
  if (!answer.ok) {
    const renewed = await renew(picture.mission_id);
    if (renewed !== undefined && "url" in renewed && renewed.artifact_id === picture.artifact_id) answer = await fetch(renewed.url, { signal, credentials: "omit" });
  }
  if (!answer.ok) throw new Error(`the store answered ${answer.status}`);
  return copyOf(asPicture(await answer.blob(), picture.path));
}
